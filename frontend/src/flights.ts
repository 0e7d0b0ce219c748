// What is left to be searched, as something to fly: rows over the gaps on the map, and their files.

import type { GeoJSONSource, Map as MapLibreMap } from "maplibre-gl";
import { api } from "./api.js";
import { make, setText } from "./dom.js";
import { collection } from "./map-layers.js";
import type { Finder, FlightRows } from "./types.js";

const NAME = "seen-rows", COLOUR = "#b000b5";
const BELOW = ["0.5", "0.7", "0.8", "0.9"], OVERLAPS: [string, string][] = [["0.2", "20 %"], ["0.3", "30 %"], ["0.5", "50 %"], ["0.7", "70 %"]], FIRST_OVERLAP = "0.3";
const FILES: [string, string][] = [["plan", "QGroundControl .plan"], ["waypoints", "MAVLink .waypoints"], ["kml", "KML"]];
const CARE = "Heights are above the place of take-off; terrain, obstacles and battery are not known: look at it before you fly it.";

/** A part that the operator opens; the rows are those of when it was pressed, on the map and in the files. */
export class Flights {
  readonly element = make("details", { class: "flights", "data-testid": "flights", hidden: true });
  private by: Finder = "machine";
  private asked = 0;
  private urls: string[] = [];
  private readonly below = choice("a gap is below this probability", "fly-below", BELOW.map((value) => [value, value]), "0.5");
  private readonly height = make("input", { type: "number", min: "1", max: "10000", placeholder: "as needed", "aria-label": "height above the ground, m", "data-testid": "fly-height" });
  private readonly overlap = choice("overlap of neighbouring rows", "fly-overlap", OVERLAPS, FIRST_OVERLAP);
  private readonly words = make("p", { class: "seen-sum", "data-testid": "fly-words" });
  private readonly files = make("div", { class: "seen", "data-testid": "fly-files" });
  private readonly gaps = make("div", { class: "seen" });

  constructor(private readonly map: MapLibreMap) {
    const show = make("button", { type: "button", class: "frame", title: "rows over the gaps for the newest picture's camera, on the map and as files", "data-testid": "fly", click: () => void this.ask() }, "Rows to fly");
    this.element.append(make("summary", {}, "Fly what is left"),
      make("div", { class: "seen" }, make("label", {}, "Below ", this.below), make("label", {}, "Height, m ", this.height), make("label", {}, "Overlap ", this.overlap), show),
      this.words, this.files, this.gaps);
    for (const input of [this.below, this.height, this.overlap]) input.addEventListener("change", () => this.clear());
    this.element.addEventListener("toggle", () => { if (!this.element.open) this.clear(); });
    this.linkGaps();
  }

  show(by: Finder): void {
    this.element.hidden = false;
    if (by !== this.by) this.clear();
    this.by = by;
    this.linkGaps();
  }

  hide(): void {
    this.element.hidden = true;
    this.element.open = false;
    this.clear();
  }

  /** Ask for the rows: nothing of an earlier choice stays. */
  private async ask(): Promise<void> {
    this.clear();
    const turn = this.asked;
    try {
      const rows = await api.flightRows(this.by, this.below.value, this.height.value, this.overlap.value);
      if (turn === this.asked) this.showRows(rows);
    } catch (error) {
      if (turn === this.asked) setText(this.words, error instanceof Error ? error.message : String(error));
    }
  }

  private showRows(rows: FlightRows): void {
    setText(this.words, `${rows.words}. ${CARE}`);
    this.files.replaceChildren(...FILES.flatMap(([kind, label]) => {
      const text = rows.files[kind];
      if (text === undefined) return [];
      const url = URL.createObjectURL(new Blob([text], { type: "application/octet-stream" }));
      this.urls.push(url);
      return [make("a", { class: "as-button", href: url, download: `gaps.${kind}`, "data-testid": `fly-${kind}` }, label)];
    }));
    this.draw(rows.way);
  }

  private linkGaps(): void {
    const link = (kind: string, label: string): HTMLElement => make("a", { class: "as-button", href: api.gapsUrl(kind, this.by, this.below.value), download: "", "data-testid": `gaps-${kind}` }, label);
    this.gaps.replaceChildren("The gaps: ", link("kml", "KML"), link("geojson", "GeoJSON"));
  }

  private clear(): void {
    this.asked += 1;
    for (const url of this.urls) URL.revokeObjectURL(url);
    this.urls = [];
    setText(this.words, "");
    this.files.replaceChildren();
    this.linkGaps();
    this.draw([]);
  }

  private draw(way: FlightRows["way"]): void {
    const data = collection(way.length < 2 ? [] : [{ type: "Feature", properties: {}, geometry: { type: "LineString", coordinates: way } }]);
    const source = this.map.getSource(NAME) as GeoJSONSource | undefined;
    if (source !== undefined) { source.setData(data); return; }
    if (way.length < 2) return;
    this.map.addSource(NAME, { type: "geojson", data });
    this.map.addLayer({ id: NAME, type: "line", source: NAME, paint: { "line-color": COLOUR, "line-width": 2 } });
  }
}

function choice(title: string, id: string, options: [string, string][], first: string): HTMLSelectElement {
  return make("select", { "aria-label": title, title, "data-testid": id }, ...options.map(([value, text]) => make("option", { value, selected: value === first }, text)));
}
