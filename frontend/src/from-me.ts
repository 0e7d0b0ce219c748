// How far a pin is from whoever looks, and in which direction, true and magnetic, while the phone's position comes.

import { make, setText } from "./dom.js";
import { distance } from "./format.js";
import { enu } from "./projection.js";
import type { PlaceAnswer } from "./types.js";

const NOWHERE = ["", "this browser may not use its position: allow it in the browser's settings of this page", "the position is not known", "no position came in time"];
const LONGEST_MS = 30_000, OLDEST_MS = 5000;
const FARTHEST_M = 500_000; // beyond it a straight line is no way

interface Position { lat_deg: number; lon_deg: number; height_m: number }

export class FromMe {
  private watch: number | null = null;

  /** Show and keep up to date until `stop`; a second press stops too. */
  toggle(place: PlaceAnswer, into: HTMLElement): void {
    if (this.watch !== null) { this.stop(); into.replaceChildren(); return; }
    const line = make("output", { "data-testid": "from-me" }, "waiting for this device's position ...");
    into.replaceChildren(line);
    into.scrollIntoView({ block: "nearest" });
    if (!window.isSecureContext || navigator.geolocation === undefined) {
      setText(line, "a browser gives its position to pages of https only: start the server with --tls-certificate");
      return;
    }
    this.watch = navigator.geolocation.watchPosition(
      (found) => void words(found.coords, place, new Date(found.timestamp)).then((text) => setText(line, text)),
      (error) => setText(line, NOWHERE[error.code] ?? error.message), { enableHighAccuracy: true, timeout: LONGEST_MS, maximumAge: OLDEST_MS });
  }

  stop(): void {
    if (this.watch !== null) navigator.geolocation.clearWatch(this.watch);
    this.watch = null;
  }
}

async function words(me: GeolocationCoordinates, place: PlaceAnswer, now: Date): Promise<string> {
  const at = { lat_deg: me.latitude, lon_deg: me.longitude, height_m: 0 };
  const { metres, bearing } = course(at, place.lat_deg, place.lon_deg);
  const own = `this device's position within ${distance(me.accuracy)} (95 %)`;
  if (metres > FARTHEST_M) return `more than 500 km from here; ${own}`;
  const variation = await declination(at, now);
  const magnetic = variation === null ? "magnetic not known: the model of the earth's field has ended" : `${degrees3(bearing - variation)} magnetic`;
  return `From me: ${metres < 1000 ? `${metres.toFixed(0)} m` : `${(metres / 1000).toFixed(2)} km`}, ${degrees3(bearing)} true, ${magnetic}; ${own}`;
}

/** Metres over the ellipsoid, and the bearing clockwise from true north, in degrees. */
export function course(from: Position, lat: number, lon: number): { metres: number; bearing: number } {
  const [east, north, up] = enu(from, lat, lon, 0);
  return { metres: Math.hypot(east, north, up), bearing: Math.atan2(east, north) * 180 / Math.PI };
}

/** By how much a compass points east of true north there (World Magnetic Model); null once its five years are over. */
export async function declination(at: Position, now: Date): Promise<number | null> {
  const { default: geomagnetism } = await import("geomagnetism"); // most never ask
  try {
    return geomagnetism.model(now).point([at.lat_deg, at.lon_deg]).decl;
  } catch {
    return null;
  }
}

function degrees3(angle: number): string { return `${String(Math.round(angle + 720) % 360).padStart(3, "0")}°`; }
