// What has been seen, on the map: a layer by age or by count with its legend, and the pictures that show a place.

import type { Map as MapLibreMap, MapMouseEvent, RasterTileSource } from "maplibre-gl";
import { api } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { clock, moment } from "./format.js";
import { PIN_LAYERS } from "./map-layers.js";
import type { State } from "./state.js";
import type { SeenAt, SeenPicture, SeenState } from "./types.js";

// In the order of COLOURS, AGES_S and COUNTS of ground/web/seen_tile.py.
const COLOURS = ["#fde725", "#5ec962", "#21918c", "#3b528b", "#440154"];
const WORDS = { age: ["under 1", "1 to 5", "5 to 20", "20 to 60", "over 60"], count: ["20 or more", "5 to 19", "2 to 4", "1"] };
const NAME = "seen";
const ABOVE = "path"; // the lowest layer above it
const LOOK_MS = 5000, COUNTING_MS = 2000; // between two questions of how it stands
type By = "age" | "count";

/** Open a picture at the place it shows. */
export type OpenSeen = (picture: SeenPicture, lat: number, lon: number) => void;

export class SeenLayer {
  private isOn = false;
  private by: By = "age";
  private shownKey = "";
  private timer = 0;
  private asked = 0;
  private readonly panel = byId("seen-panel");
  private readonly found = make("div", { class: "seen", "data-testid": "seen-found" });
  private readonly unit = make("p", { class: "seen-sum" });
  private readonly legend = make("ul", { class: "seen-legend" });
  private readonly sum = make("p", { class: "seen-sum", "data-testid": "seen-sum" });

  constructor(private readonly map: MapLibreMap, private readonly state: State, private readonly open: OpenSeen) {
    const by = make("select", { "aria-label": "colours show", "data-testid": "seen-by" }, make("option", { value: "age" }, "by age"), make("option", { value: "count" }, "by how often"));
    by.addEventListener("change", () => { this.by = by.value === "count" ? "count" : "age"; this.drawLegend(); void this.look(); });
    this.panel.append(make("div", { class: "seen-head" }, make("strong", {}, "Seen"), by), this.unit, this.legend, this.sum, this.found);
    byId("show-seen").addEventListener("click", () => this.turn(!this.isOn));
    map.on("click", (event) => this.clicked(event));
  }

  private turn(on: boolean): void {
    this.isOn = on;
    byId("show-seen").setAttribute("aria-pressed", String(on));
    this.panel.hidden = !on;
    window.clearTimeout(this.timer);
    this.found.replaceChildren(make("span", { class: "muted" }, "Click the map: the pictures that show the place."));
    if (on) { this.drawLegend(); void this.look(); return; }
    this.shownKey = "";
    if (this.map.getLayer(NAME) !== undefined) this.map.removeLayer(NAME);
    if (this.map.getSource(NAME) !== undefined) this.map.removeSource(NAME);
  }

  private drawLegend(): void {
    const isLive = this.state.server?.is_live === true;
    setText(this.unit, this.by === "count" ? "Pictures that saw it:" : isLive ? "Last seen, minutes ago:" : "Last seen, minutes before the recording's end:");
    this.legend.replaceChildren(...WORDS[this.by].map((text, k) => {
      const swatch = make("i", {});
      swatch.style.background = COLOURS[k]!;
      return make("li", {}, swatch, text);
    }), make("li", { class: "muted" }, make("i", {}), "not seen for certain"));
  }

  /** Ask how it stands, and draw what is new: again and again while the layer is on. */
  private async look(): Promise<void> {
    window.clearTimeout(this.timer);
    const turn = ++this.asked;
    let pause = LOOK_MS;
    try {
      const now = await api.seenState();
      if (now.ahead !== 0) pause = COUNTING_MS;
      if (!this.isOn || turn !== this.asked) return;
      setText(this.sum, sumText(now));
      this.sum.dataset["ahead"] = String(now.ahead); // what a test may wait for
      this.draw(now);
    } catch { /* the page shows that the server does not answer */ }
    if (this.isOn && turn === this.asked) this.timer = window.setTimeout(() => void this.look(), pause);
  }

  private draw(now: SeenState): void {
    // Of a live flight the colours age: they are rendered again from time to time.
    const key = `${this.by}&v=${now.version}${now.is_live ? `.${Math.floor(Date.now() / 30_000)}` : ""}`;
    if (key === this.shownKey) return;
    this.shownKey = key;
    const tiles = [`${location.origin}/api/seen/tiles/{z}/{x}/{y}?by=${key}`];
    const source = this.map.getSource(NAME) as RasterTileSource | undefined;
    if (source !== undefined) { source.setTiles(tiles); return; }
    this.map.addSource(NAME, { type: "raster", tiles, tileSize: 256, maxzoom: 22 });
    this.map.addLayer({ id: NAME, type: "raster", source: NAME, paint: { "raster-fade-duration": 0, "raster-resampling": "nearest" } }, ABOVE);
  }

  private clicked(event: MapMouseEvent): void {
    if (!this.isOn || this.map.queryRenderedFeatures(event.point, { layers: PIN_LAYERS }).length > 0) return;
    const { lat, lng: lon } = event.lngLat;
    api.seenAt(lat, lon).then((reply) => { this.list(reply); this.found.scrollIntoView({ block: "nearest" }); }, (error: unknown) => { this.found.textContent = error instanceof Error ? error.message : String(error); });
  }

  private list(reply: SeenAt): void {
    const button = (picture: SeenPicture, text: string, id: string): HTMLElement => {
      const isHeld = (this.state.frames.get(picture.vehicle) ?? []).some((row) => row.frame === picture.frame && row.session === picture.session);
      const title = `${picture.vehicle}, ${clock(picture.capture_unix_ns)}, ${distanceText(picture.gsd_m)} from pixel to pixel${isHeld ? "" : "; of an earlier session, no longer here"}`;
      return make("button", { type: "button", class: "frame", title, disabled: !isHeld, "data-testid": id, click: () => this.open(picture, reply.lat_deg, reply.lon_deg) }, text);
    };
    if (reply.count === 0 || reply.first_utc === null || reply.last_utc === null) { this.found.replaceChildren("Not seen for certain."); return; }
    const [first, last] = [moment(reply.first_utc), moment(reply.last_utc)], isOneDay = first.slice(0, 10) === last.slice(0, 10);
    const times = first === last ? last : `${first.replace(" UTC", "")} to ${isOneDay ? last.slice(11) : last}`;
    const head = `Seen ${reply.count === 1 ? "once" : `${reply.count} times`}, ${times}.`;
    this.found.replaceChildren(make("span", {}, head),
      ...(reply.finest === null ? [] : [button(reply.finest, `Finest: ${reply.finest.frame} (${distanceText(reply.finest.gsd_m)})`, "seen-finest")]),
      ...reply.pictures.map((picture) => button(picture, String(picture.frame), "seen-picture")));
  }
}

function sumText(now: SeenState): string {
  const area = now.area_m2 >= 1e5 ? `${(now.area_m2 / 1e6).toFixed(2)} km²` : `${(now.area_m2 / 1e4).toFixed(2)} ha`;
  const parts = [`${area} in ${now.pictures} pictures`];
  if (now.cell_m !== null) parts.push(`cells of ${now.cell_m}\u00a0m`);
  if (now.ahead === null) parts.push("counting begins");
  else if (now.ahead > 0) parts.push(`${now.ahead} pictures still to be counted`);
  if (now.left_out > 0) parts.push(`${now.left_out} pictures reach too far to be counted`);
  if (now.is_full) parts.push("too large a ground: the part seen longest ago is no longer shown");
  if (now.trouble !== "") parts.push(now.trouble);
  return parts.join("; ");
}

function distanceText(metres: number): string {
  return metres < 1 ? `${(metres * 100).toPrecision(2)} cm` : `${metres.toPrecision(2)} m`;
}
