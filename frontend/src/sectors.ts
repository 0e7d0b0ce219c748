// Sectors of the search on the map: outlined by their corners, read from a file, kept as one; and woods, which hide the ground.

import type { GeoJSONSource, Map as MapLibreMap, MapMouseEvent } from "maplibre-gl";
import { api } from "./api.js";
import { make, setText } from "./dom.js";
import { collection } from "./map-layers.js";

type Corner = [number, number]; // longitude and latitude

const NAME = "seen-outline", COLOUR = "#d0021b";
const SAME_PX = 3; // a second press so near the last one is a double click's
const METRES_A_DEGREE = 111_195;

export class Sectors {
  readonly element = make("div", { hidden: true });
  private corners: Corner[] = [];
  private isSetting = false;
  private readonly words = make("span", { class: "muted", "data-testid": "draw-words" });
  private readonly name = make("input", { type: "text", maxlength: "60", placeholder: "name", "aria-label": "the sector's name", "data-testid": "draw-name" });
  private readonly back = press("Back", "take back the last corner", "draw-back", () => this.takeBack());
  private readonly done = press("Done", "the sector is complete (Enter)", "draw-done", () => this.finish());
  private readonly drawing = make("div", { class: "seen", hidden: true }, this.words, this.name, this.back, this.done, press("Cancel", "draw no sector (Escape)", "draw-cancel", () => this.turn(false)));
  private readonly names = make("div", { class: "seen only-operators", "data-testid": "sector-names" });
  private readonly noWoods = press("No woods", "no trees hide the ground", "no-woods", () => this.choose(api.noWoods()));
  private readonly choices = make("div", { class: "seen only-operators" },
    press("Draw a sector", "click its corners on the map, for a number of its own", "draw", () => this.turn(true)),
    ...chosen("Sectors ...", "areas of a GeoJSON, KML or KMZ file, for a number each", "sectors", ".geojson,.json,.kml,.kmz", (file) => this.choose(api.seenSectors(file))),
    ...chosen("Woods ...", "areas of a GeoJSON file with `canopy`, the share of the ground that trees hide, 0 to 1", "woods", ".geojson,.json", (file) => this.choose(api.woods(file))),
    this.noWoods);
  private readonly whole = make("div", { class: "seen", hidden: true },
    make("a", { class: "as-button", href: api.sectorsUrl, download: "", title: "the sectors as a file, to be read here again", "data-testid": "keep-sectors" }, "Keep as a file"),
    press("No sectors", "no sectors: all that was seen", "no-sectors", () => this.choose(api.noSectors()), "only-operators"));

  /** `choose` is given what changes the sectors or the woods, and shows what comes of it. `hold` keeps the map where it is. */
  constructor(private readonly map: MapLibreMap, private readonly choose: (done: Promise<unknown>) => void, private readonly hold: () => void) {
    this.element.append(this.drawing, this.choices, this.names, this.whole);
    map.on("click", (event) => { if (this.isSetting) this.set(event); });
    document.addEventListener("keydown", (event) => { if (this.isSetting) this.key(event); }, { capture: true });
  }

  /** Return whether a press on the map sets a corner. */
  get isDrawing(): boolean { return this.isSetting; }

  show(): void { this.element.hidden = false; }

  hide(): void {
    this.element.hidden = true;
    this.turn(false);
  }

  /** Show which sectors there are, and of how many woods it is known. */
  list(names: readonly string[], woods: number): void {
    this.whole.hidden = names.length === 0;
    this.noWoods.hidden = woods === 0;
    setText(this.noWoods, `No woods (${woods})`);
    if (JSON.stringify(names) === this.names.dataset["names"]) return;
    this.names.dataset["names"] = JSON.stringify(names);
    this.names.replaceChildren(...names.map((name) => press(`${name} ×`, `no sector ${name}`, "no-sector", () => this.choose(api.noSector(name)))));
  }

  private turn(on: boolean): void {
    if (on === this.isSetting) return;
    this.isSetting = on;
    this.corners = [];
    this.name.value = "";
    this.drawing.hidden = !on;
    this.choices.hidden = on;
    this.map.getCanvas().style.cursor = on ? "crosshair" : "";
    if (on) { this.hold(); this.map.doubleClickZoom.disable(); } else this.map.doubleClickZoom.enable();
    this.draw();
  }

  private set({ lngLat, point }: MapMouseEvent): void {
    const last = this.corners.at(-1);
    if (last !== undefined && this.map.project(last).dist(point) < SAME_PX) return;
    this.corners.push([lngLat.lng, lngLat.lat]);
    this.draw();
  }

  private takeBack(): void {
    this.corners.pop();
    this.draw();
  }

  private finish(): void {
    if (this.corners.length < 3) return;
    const outlined = api.outlinedSector(this.name.value, this.corners);
    outlined.then(() => { this.turn(false); this.choose(outlined); }, (error: unknown) => setText(this.words, error instanceof Error ? error.message : String(error)));
  }

  /** Keys of the page, as of clicking in the picture, are not meant while a sector is outlined. */
  private key(event: KeyboardEvent): void {
    const isTyping = event.target === this.name;
    if (event.key === "Escape") this.turn(false);
    else if (event.key === "Enter" && !(event.target instanceof HTMLButtonElement)) this.finish();
    else if (event.key === "Backspace" && !isTyping) this.takeBack();
    else return;
    event.stopPropagation();
    event.preventDefault();
  }

  private draw(): void {
    const count = this.corners.length, [first] = this.corners;
    this.back.disabled = count === 0;
    this.done.disabled = count < 3;
    setText(this.words, count === 0 ? "Click the sector's corners on the map, in order round it." : `${count} corner${count === 1 ? "" : "s"}${count < 3 ? "" : `, ${(areaM2(this.corners) / 1e4).toPrecision(3)} ha`}`);
    const points = this.corners.map((coordinates) => ({ type: "Feature" as const, properties: {}, geometry: { type: "Point" as const, coordinates } }));
    const line = count < 2 || first === undefined ? [] : [{ type: "Feature" as const, properties: {}, geometry: { type: "LineString" as const, coordinates: [...this.corners, first] } }];
    const data = collection([...points, ...line]), source = this.map.getSource(NAME) as GeoJSONSource | undefined;
    if (source !== undefined) { source.setData(data); return; }
    if (count === 0) return;
    this.map.addSource(NAME, { type: "geojson", data });
    this.map.addLayer({ id: NAME, type: "line", source: NAME, paint: { "line-color": COLOUR, "line-width": 2, "line-dasharray": [2, 1] } });
    this.map.addLayer({ id: `${NAME}-corners`, type: "circle", source: NAME, filter: ["==", ["geometry-type"], "Point"], paint: { "circle-color": COLOUR, "circle-radius": 5, "circle-stroke-color": "#fff", "circle-stroke-width": 2 } });
  }
}

/** The area of a ring as small as a sector is, m2. */
function areaM2(ring: readonly Corner[]): number {
  const [lon0, lat0] = ring[0] ?? [0, 0], metresEast = METRES_A_DEGREE * Math.cos(lat0 * Math.PI / 180);
  const places = ring.map(([lon, lat]) => [(lon - lon0) * metresEast, (lat - lat0) * METRES_A_DEGREE] as const);
  const twice = places.reduce((sum, [x, y], k) => { const [nextX, nextY] = places[(k + 1) % places.length]!; return sum + x * nextY - nextX * y; }, 0);
  return Math.abs(twice) / 2;
}

function press(label: string, title: string, id: string, run: () => void, kind = ""): HTMLButtonElement {
  return make("button", { type: "button", class: `frame ${kind}`.trim(), title, "data-testid": id, click: run }, label);
}

/** A button that has a file chosen, and the input that it presses. */
function chosen(label: string, title: string, id: string, accept: string, take: (file: File) => void): HTMLElement[] {
  const input = make("input", { type: "file", accept, hidden: true, "data-testid": `${id}-file` });
  input.addEventListener("change", () => { const [file] = input.files ?? []; if (file !== undefined) take(file); input.value = ""; });
  return [press(label, title, id, () => input.click()), input];
}
