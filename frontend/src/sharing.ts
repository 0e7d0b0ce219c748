// A pin to another program: by the phone's own sheet, or as a geo: link and a code to photograph.

import { api } from "./api.js";
import { make } from "./dom.js";
import { within } from "./format.js";
import { kindOf } from "./shapes.js";
import type { Pin, PlaceAnswer } from "./types.js";

/** Share a pin whose coordinate is written `text`; what to press instead goes into `into` where there is no sheet. */
export async function share(pin: Pin, text: string, into: HTMLElement): Promise<void> {
  if (pin.place.status !== "ok") return;
  const geo = geoUri(pin.place), title = `${kindOf(pin.category).title} ${pin.number}${pin.name === "" ? "" : `, ${pin.name}`}`;
  const sheet = { title, text: `${title}: ${text}, ${within(pin.place.ce90_m)} (WGS84)\n${geo}` };
  // Browsers have the sheet on pages of https and of this machine alone, and not all have it.
  if (navigator.share !== undefined) {
    try { await navigator.share(sheet); } catch (error) { if (!(error instanceof DOMException && error.name === "AbortError")) throw error; }
    return;
  }
  into.replaceChildren(make("img", { class: "qr", alt: "QR code of the position, for a phone's camera", src: `${api.qrUrl(pin.id)}?v=${encodeURIComponent(pin.modified_utc)}` }),
    make("a", { class: "as-button", href: geo, "data-testid": "geo" }, "Open in a map program"));
  into.scrollIntoView({ block: "nearest" });
}

/** RFC 5870, as `geo_uri` of ground/web/handoff.py. */
function geoUri({ lat_deg, lon_deg, height_ellipsoid_m: height, ce90_m }: PlaceAnswer): string {
  const within = ce90_m === null ? "" : `;u=${(Math.ceil(ce90_m * 10 - 1e-9) / 10).toFixed(1)}`;
  return `geo:${lat_deg.toFixed(7)},${lon_deg.toFixed(7)}${height === null ? "" : `,${height.toFixed(1)}`}${within}`;
}
