// What has been seen, on the map: a layer by age, by count or by who would have been found, with its legend and numbers by
// sector, and the pictures that show a place.

import type { GeoJSONSource, Map as MapLibreMap, MapMouseEvent, RasterTileSource } from "maplibre-gl";
import { api } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { clock, moment } from "./format.js";
import { Flights } from "./flights.js";
import { PIN_LAYERS, collection } from "./map-layers.js";
import { Sectors } from "./sectors.js";
import type { State } from "./state.js";
import type { Finder, SeenAt, SeenDetection, SeenPicture, SeenState } from "./types.js";

// In the order of COLOURS, AGES_S, COUNTS and PROBABILITIES of ground/web/seen_tile.py.
const COLOURS = ["#fde725", "#5ec962", "#21918c", "#3b528b", "#440154"];
const LIKELY = ["0.9 and more", "0.7 to 0.9", "0.5 to 0.7", "0.2 to 0.5", "under 0.2"];
const WORDS = { age: ["under 1", "1 to 5", "5 to 20", "20 to 60", "over 60"], count: ["20 or more", "5 to 19", "2 to 4", "1"], machine: LIKELY, operator: LIKELY };
const CHOICES: [By, string][] = [["age", "by age"], ["count", "by how often"], ["machine", "found by machine"], ["operator", "found by operator"]];
const NAME = "seen", SECTORS = "seen-sectors";
const ABOVE = "path"; // the lowest layer above it
const LOOK_MS = 5000, COUNTING_MS = 2000, COMPUTING_MS = 500; // between two questions of how it stands
type By = "age" | "count" | Finder;

const isFinder = (by: By): by is Finder => by === "machine" || by === "operator";

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
  private readonly numbers = make("ul", { class: "seen-numbers", "data-testid": "seen-numbers" });
  private readonly sectors: Sectors;
  private readonly flights: Flights;

  constructor(private readonly map: MapLibreMap, private readonly state: State, private readonly open: OpenSeen, hold: () => void) {
    const by = make("select", { "aria-label": "colours show", "data-testid": "seen-by" }, ...CHOICES.map(([value, text]) => make("option", { value }, text)));
    by.addEventListener("change", () => { this.by = CHOICES[by.selectedIndex]![0]; this.drawLegend(); void this.look(); });
    this.sectors = new Sectors(map, (done) => this.choose(done), hold);
    this.flights = new Flights(map);
    this.panel.append(make("div", { class: "seen-head" }, make("strong", {}, "Seen"), by), this.unit, this.numbers, this.legend, this.sectors.element, this.flights.element, this.sum, this.found);
    byId("show-seen").addEventListener("click", () => this.turn(!this.isOn));
    map.on("click", (event) => this.clicked(event));
  }

  /** Return whether a press on the map sets a sector's corner. */
  get isDrawing(): boolean { return this.sectors.isDrawing; }

  private turn(on: boolean): void {
    this.isOn = on;
    if (!on) { this.sectors.hide(); this.flights.hide(); }
    byId("show-seen").setAttribute("aria-pressed", String(on));
    this.panel.hidden = !on;
    window.clearTimeout(this.timer);
    this.found.replaceChildren(make("span", { class: "muted" }, "Click the map: the pictures that show the place."));
    if (on) { this.drawLegend(); void this.look(); return; }
    this.shownKey = "";
    this.outline([]);
    if (this.map.getLayer(NAME) !== undefined) this.map.removeLayer(NAME);
    if (this.map.getSource(NAME) !== undefined) this.map.removeSource(NAME);
  }

  private drawLegend(): void {
    const isLive = this.state.server?.is_live === true;
    this.numbers.hidden = !isFinder(this.by);
    if (isFinder(this.by)) { this.numbers.replaceChildren(); setText(this.unit, "Would have been found:"); this.sectors.show(); this.flights.show(this.by); } else { this.outline([]); this.sectors.hide(); this.flights.hide(); }
    if (!isFinder(this.by)) setText(this.unit, this.by === "count" ? "Pictures that saw it:" : isLive ? "Last seen, minutes ago:" : "Last seen, minutes before the recording's end:");
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
      const by = this.by, now = await api.seenState(), detection = isFinder(by) ? await api.seenDetection() : null;
      if (now.ahead !== 0) pause = COUNTING_MS;
      if (!this.isOn || turn !== this.asked) return;
      setText(this.sum, sumText(now));
      this.sum.dataset["ahead"] = String(now.ahead); // what a test may wait for
      if (detection !== null && isFinder(by)) {
        if (!detection.is_current) pause = COMPUTING_MS;
        this.showNumbers(detection, by);
      }
      this.draw(now, detection);
    } catch { /* the page shows that the server does not answer */ }
    if (this.isOn && turn === this.asked) this.timer = window.setTimeout(() => void this.look(), pause);
  }

  /** Show what is taken for granted and the numbers of each sector. */
  private showNumbers(now: SeenDetection, by: Finder): void {
    setText(this.unit, `Would have been found ${now.assumed[by]}.`);
    const none = now.detection === null ? "not computed yet" : "no picture of a calibrated thermal camera was searched for people";
    const lines = now.lines[by].length > 0 ? now.lines[by] : [none];
    if ((now.detection?.unmatched_reports ?? 0) > 0 && by === "machine") lines.push(`not counted: ${now.detection!.unmatched_reports} searched pictures whose ground is not known here`);
    if (now.trouble !== "") lines.push(now.trouble);
    this.numbers.replaceChildren(...lines.map((line) => make("li", {}, line)));
    this.numbers.dataset["current"] = String(now.is_current); // what a test may wait for
    this.outline(now.sectors);
    this.sectors.list(now.sectors.map(({ name }) => name), now.woods);
  }

  private choose(done: Promise<unknown>): void {
    done.then(() => this.look(), (error: unknown) => { this.numbers.replaceChildren(make("li", {}, error instanceof Error ? error.message : String(error))); });
  }

  private outline(sectors: SeenDetection["sectors"]): void {
    const data = collection(sectors.flatMap(({ name, rings }) => rings.map((ring) => ({ type: "Feature", properties: { name }, geometry: { type: "LineString", coordinates: [...ring, ring[0]!] } }))));
    const source = this.map.getSource(SECTORS) as GeoJSONSource | undefined;
    if (source !== undefined) { source.setData(data); return; }
    if (sectors.length === 0) return;
    this.map.addSource(SECTORS, { type: "geojson", data });
    this.map.addLayer({ id: SECTORS, type: "line", source: SECTORS, paint: { "line-color": "#d0021b", "line-width": 2 } }, ABOVE);
  }

  private draw(now: SeenState, detection: SeenDetection | null): void {
    // Of a live flight the colours age: they are rendered again from time to time.
    const version = detection?.version ?? `${now.version}${now.is_live ? `.${Math.floor(Date.now() / 30_000)}` : ""}`;
    const key = `${this.by}&v=${version}`;
    if (key === this.shownKey) return;
    this.shownKey = key;
    const tiles = [`${location.origin}/api/seen/tiles/{z}/{x}/{y}?by=${key}`];
    const source = this.map.getSource(NAME) as RasterTileSource | undefined;
    if (source !== undefined) { source.setTiles(tiles); return; }
    this.map.addSource(NAME, { type: "raster", tiles, tileSize: 256, maxzoom: 22 });
    this.map.addLayer({ id: NAME, type: "raster", source: NAME, paint: { "raster-fade-duration": 0, "raster-resampling": "nearest" } }, ABOVE);
  }

  private clicked(event: MapMouseEvent): void {
    if (!this.isOn || this.isDrawing || this.map.queryRenderedFeatures(event.point, { layers: PIN_LAYERS }).length > 0) return;
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
