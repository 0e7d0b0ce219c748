// The map pane: works with no tiles at all; grid, flight path, footprint, features, pictures on the ground, pins and ties.

import * as maplibregl from "maplibre-gl";
import type { GeoJSONSource, ImageSource, Map as MapLibreMap, StyleSpecification } from "maplibre-gl";
import { Protocol } from "pmtiles";
import { baseLayers, baseSource } from "./base-map.js";
import { byId, say } from "./dom.js";
import { gridLines } from "./grid.js";
import { distance } from "./format.js";
import { ellipseRing } from "./projection.js";
import { AIRCRAFT, KINDS, kindOf } from "./shapes.js";
import type { State } from "./state.js";
import type { Viewer } from "./viewer.js";
import type { FrameView, Pin, PlaceAnswer, Tie, Tiles } from "./types.js";

declare const WORKER_URL: string;

const LAID_PICTURES = 16;
const MOST_DRAWN = 500; // of more pins than that all but the chosen one are dots
const PIN_ICON = 28;
type What = "shown" | "pins" | "path";
// The map is drawn so long after the last change, and after the first one: pins once the clicking pauses.
const LATER_MS = 120, LATEST_MS: Record<What, number> = { shown: 500, pins: 10_000, path: 3000 };
const ABOVE_PICTURES = "footprint-fill"; // the lowest layer that lies on the pictures
type Feature = { type: "Feature"; id?: number; geometry: { type: string; coordinates: unknown }; properties: Record<string, unknown> };

interface Palette { ground: string; grid: string; major: string; text: string; halo: string }
const PALETTES: Record<"day" | "night", Palette> = {
  day: { ground: "#eef1f4", grid: "#d3dae2", major: "#aab6c4", text: "#1b2530", halo: "#ffffff" },
  night: { ground: "#10161d", grid: "#202c38", major: "#36475a", text: "#e6edf3", halo: "#000000" },
};

export class MapPane {
  private readonly map: MapLibreMap;
  private readonly laid = new Map<string, { source: string; layer: string }>();
  private isReady = false;
  private isFollowing = true;
  private hasView = false;
  private theme: "day" | "night" = "day";
  private readonly waiting = new Map<What, { timer: number; latest: number }>();
  private drawnPath: [number, number][] | null = null;
  private drawnTies: Tie[] | null = null;
  private readonly onMap = new Map<string, MapPin>();
  private isCrowded = false;
  private origin: { lat: number; lon: number } | null = null;

  constructor(private readonly state: State, private readonly viewer: Viewer, tiles: Tiles | null) {
    maplibregl.setWorkerUrl(WORKER_URL);
    if (tiles?.kind === "pmtiles") maplibregl.addProtocol("pmtiles", new Protocol().tile);
    this.map = new maplibregl.Map({
      container: byId("map"),
      style: emptyStyle(tiles),
      center: [0, 0],
      zoom: 1,
      maxZoom: 24,
      maxPitch: 0,
      dragRotate: true,
      attributionControl: tiles === null ? false : { compact: true },
      fadeDuration: 0,
      canvasContextAttributes: { antialias: false, preserveDrawingBuffer: false },
    });
    this.map.touchZoomRotate.enable();
    this.map.addControl(new maplibregl.NavigationControl({ showCompass: true }), "top-right");
    this.map.addControl(new maplibregl.ScaleControl({ unit: "metric" }), "bottom-left");
    this.map.on("dragstart", () => this.follow(false));
    this.map.once("load", () => this.ready(tiles));
    this.map.on("error", (event) => { console.debug("map", event.error.message); });
    byId("follow").addEventListener("click", () => this.follow(!this.isFollowing));
    byId("fit").addEventListener("click", () => this.fit());
  }

  setTheme(theme: "day" | "night"): void {
    this.theme = theme;
    if (this.isReady) this.paintTheme();
  }

  resize(): void { this.map.resize(); }

  /** Bring a place into sight. */
  goTo(lat: number, lon: number): void {
    this.follow(false);
    if (!this.map.getBounds().contains([lon, lat])) this.map.easeTo({ center: [lon, lat], duration: 300 });
  }

  private follow(on: boolean): void {
    this.isFollowing = on;
    byId("follow").setAttribute("aria-pressed", String(on));
    if (on) this.centre(this.state.shown);
  }

  private fit(): void {
    const bounds = new maplibregl.LngLatBounds();
    for (const pin of this.state.pins.values()) for (const p of placesOf(pin)) bounds.extend([p.lon_deg, p.lat_deg]);
    for (const place of this.state.paths.get(this.state.vehicle ?? "") ?? []) bounds.extend(place);
    for (const place of this.state.shown?.footprint ?? []) bounds.extend(place);
    this.follow(false);
    if (!bounds.isEmpty()) this.map.fitBounds(bounds, { padding: 50, maxZoom: 20, duration: 300 });
  }

  private ready(tiles: Tiles | null): void {
    this.isReady = true;
    const map = this.map;
    for (const name of ["grid", "path", "footprint", "features", "ellipses", "pins", "ties", "craft"]) {
      map.addSource(name, { type: "geojson", data: collection([]), promoteId: "key" });
    }
    for (const kind of KINDS) for (const isMarked of [false, true]) {
      map.addImage(`${kind.word}${isMarked ? "-marked" : ""}`, icon(kind.path, kind.colour, isMarked), { pixelRatio: 2 });
    }
    map.addImage("tie", icon("M12 1v22M1 12h22", "#111", false, true), { pixelRatio: 2 });
    map.addLayer({ id: "grid", type: "line", source: "grid", layout: { visibility: tiles === null ? "visible" : "none" }, paint: { "line-width": 1 } });
    map.addLayer({ id: "footprint-fill", type: "fill", source: "footprint", paint: { "fill-color": ["get", "colour"], "fill-opacity": 0.06 } });
    map.addLayer({ id: "footprint", type: "line", source: "footprint", paint: { "line-color": ["get", "colour"], "line-width": 2 } });
    map.addLayer({ id: "path", type: "line", source: "path", paint: { "line-color": ["get", "colour"], "line-width": 2, "line-dasharray": [2, 1.5] } });
    map.addLayer({ id: "features", type: "circle", source: "features", paint: { "circle-radius": 2.5, "circle-color": "#7dd3fc", "circle-stroke-color": "#0b2545", "circle-stroke-width": 1 } });
    map.addLayer({ id: "ellipse-fill", type: "fill", source: "ellipses", paint: { "fill-color": ["get", "colour"], "fill-opacity": 0.16 } });
    map.addLayer({ id: "ellipse", type: "line", source: "ellipses", paint: { "line-color": ["get", "colour"], "line-width": 1.5 } });
    map.addLayer({ id: "craft", type: "circle", source: "craft", paint: { "circle-radius": 6, "circle-color": ["get", "colour"], "circle-stroke-color": "#fff", "circle-stroke-width": 2 } });
    map.addLayer({ id: "ties", type: "symbol", source: "ties", layout: { "icon-image": "tie", "icon-allow-overlap": true } });
    map.addLayer({ id: "dots", type: "circle", source: "pins", filter: ["get", "small"], paint: { "circle-radius": 5, "circle-color": ["get", "colour"], "circle-stroke-color": "#fff", "circle-stroke-width": 1.5 } });
    map.addLayer({
      id: "pins", type: "symbol", source: "pins", filter: ["!", ["get", "small"]],
      layout: {
        "icon-image": ["get", "icon"], "icon-allow-overlap": true, "icon-ignore-placement": true, "symbol-sort-key": ["get", "order"],
        "text-field": ["get", "label"], "text-font": ["sans-serif"], "text-size": 11, "text-allow-overlap": true, "text-ignore-placement": true,
      },
      paint: { "text-color": "#ffffff" },
    });
    map.addLayer({
      id: "names", type: "symbol", source: "pins", filter: ["all", ["!", ["get", "small"]], ["!=", ["get", "name"], ""]],
      layout: { "text-field": ["get", "name"], "text-font": ["sans-serif"], "text-size": 12, "text-offset": [0, 1.3], "text-anchor": "top", "text-optional": true },
      paint: { "text-halo-width": 1.5 },
    });
    map.on("moveend", () => this.drawGrid());
    const drawn = ["dots", "pins"];
    map.on("mousemove", drawn, (event) => { this.state.hover(String(event.features?.[0]?.properties["id"] ?? "")); map.getCanvas().style.cursor = "pointer"; });
    map.on("mouseleave", drawn, () => { this.state.hover(null); map.getCanvas().style.cursor = ""; });
    map.on("click", drawn, (event) => this.state.select(String(event.features?.[0]?.properties["id"] ?? "")));
    this.paintTheme();
    this.state.on(["shown"], () => this.later("shown"));
    this.state.on(["pins", "hover", "selected"], () => this.later("pins"));
    this.state.on(["frames", "vehicles"], () => this.later("path"));
    this.state.on(["options"], () => this.later("shown"));
    for (const what of ["shown", "pins", "path"] as const) this.later(what);
  }

  /** After the picture and its answer, which are waited for: once nothing more comes, or at last after a while. */
  private later(what: What): void {
    const now = performance.now(), held = this.waiting.get(what);
    if (held !== undefined) window.clearTimeout(held.timer);
    const latest = held?.latest ?? now + LATEST_MS[what];
    const timer = window.setTimeout(() => requestAnimationFrame(() => {
      if (this.waiting.get(what)?.timer !== timer) return; // changed once more since
      // Never between a press and its answer: on a slow machine each click would wait for the map of the one before.
      if (this.state.clicksUnderWay > 0 && performance.now() < latest) { this.later(what); return; }
      this.waiting.delete(what);
      if (what === "path") this.drawPath();
      else if (what === "shown") this.drawShown();
      else this.drawPins();
    }), Math.min(LATER_MS, Math.max(latest - now, 0)));
    this.waiting.set(what, { timer, latest });
  }

  private set(name: string, features: Feature[]): void {
    (this.map.getSource(name) as GeoJSONSource).setData(collection(features));
  }

  private drawShown(): void {
    const shown = this.state.shown;
    const isDrawn = shown !== null && shown.camera !== null;
    const properties = { colour: this.colour() };
    this.set("footprint", isDrawn && shown.footprint.length > 3 ? [{ type: "Feature", geometry: { type: "Polygon", coordinates: [shown.footprint] }, properties }] : []);
    this.set("features", isDrawn && this.state.options.features ? shown.features.lonlat.map((at) => ({ type: "Feature", geometry: { type: "Point", coordinates: at }, properties: {} })) : []);
    this.set("craft", isDrawn && shown.camera !== null ? [{ type: "Feature", geometry: { type: "Point", coordinates: [shown.camera.lon_deg, shown.camera.lat_deg] }, properties }] : []);
    this.lay();
    if (this.isFollowing || !this.hasView) this.centre(shown);
    if (this.origin === null) this.drawGrid();
  }

  private centre(shown: FrameView | null): void {
    if (shown === null || shown.footprint.length < 3) return;
    const bounds = new maplibregl.LngLatBounds();
    for (const place of shown.footprint) bounds.extend(place);
    if (!this.hasView) {
      this.hasView = true;
      this.map.fitBounds(bounds, { padding: { top: 60, bottom: 60, left: 60, right: 60 }, maxZoom: 21, duration: 0 });
    } else if (this.isFollowing) {
      this.map.easeTo({ center: bounds.getCenter(), duration: 250 });
    }
  }

  /** The last pictures as they lie on the ground, the one that is shown on top. */
  private lay(): void {
    const loaded = this.viewer.loaded;
    const isOn = this.state.options.pictures;
    for (const [key, held] of this.laid) {
      if (!isOn || this.laid.size > LAID_PICTURES) {
        this.map.removeLayer(held.layer);
        this.map.removeSource(held.source);
        this.laid.delete(key);
      }
    }
    if (!isOn || loaded === null || loaded.image === null || loaded.view.corners === null) return;
    const { view } = loaded;
    const key = `${view.vehicle}/${view.session}/${view.frame}`;
    const corners = view.corners as [[number, number], [number, number], [number, number], [number, number]];
    const held = this.laid.get(key);
    if (held !== undefined) {
      (this.map.getSource(held.source) as ImageSource).setCoordinates(corners);
      this.map.moveLayer(held.layer, ABOVE_PICTURES);
    } else {
      const name = `picture ${key}`;
      this.map.addSource(name, { type: "image", coordinates: corners });
      (this.map.getSource(name) as ImageSource).updateImage({ image: copied(loaded.image), coordinates: corners });
      this.map.addLayer({ id: name, type: "raster", source: name, paint: { "raster-fade-duration": 0, "raster-opacity": 0.95 } }, ABOVE_PICTURES);
      this.laid.set(key, { source: name, layer: name });
    }
  }

  private drawPath(): void {
    const path = this.state.paths.get(this.state.vehicle ?? "") ?? [];
    if (path === this.drawnPath) return; // a status comes every second, and drawing costs
    this.drawnPath = path;
    this.set("path", path.length < 2 ? [] : [{ type: "Feature", geometry: { type: "LineString", coordinates: path }, properties: { colour: this.colour() } }]);
  }

  private drawPins(): void {
    const { hovered, selected, pins } = this.state;
    const isCrowded = pins.size > MOST_DRAWN;
    if (isCrowded !== this.isCrowded) this.onMap.clear();
    this.isCrowded = isCrowded;
    // Only what has changed goes to the map: a pin is the same object until it changes.
    const changed: MapPin[] = [], gone: string[] = [];
    const isAnew = this.onMap.size === 0;
    for (const pin of pins.values()) {
      const isMarked = pin.id === hovered || pin.id === selected, held = this.onMap.get(pin.id);
      if (held !== undefined && held.pin === pin && held.isMarked === isMarked) continue;
      if (held !== undefined) gone.push(...held.keys);
      const made = mapPin(pin, isMarked, isCrowded && !isMarked);
      this.onMap.set(pin.id, made);
      changed.push(made);
    }
    for (const [id, held] of this.onMap) if (!pins.has(id)) { gone.push(...held.keys); this.onMap.delete(id); }
    for (const name of ["pins", "ellipses"] as const) {
      if (isAnew || changed.length > pins.size / 2) this.set(name, [...this.onMap.values()].flatMap((made) => made[name]));
      else if (changed.length > 0 || gone.length > 0) {
        const add = changed.flatMap((made) => made[name]), added = new Set(add.map((feature) => feature.properties["key"]));
        const remove = gone.filter((key) => !added.has(key));
        (this.map.getSource(name) as GeoJSONSource).updateData({ add, remove } as unknown as Parameters<GeoJSONSource["updateData"]>[0]);
      }
    }
    if (this.state.ties === this.drawnTies) return;
    this.drawnTies = this.state.ties;
    this.set("ties", this.state.ties.map((tie) => ({ type: "Feature", geometry: { type: "Point", coordinates: [tie.lon_deg, tie.lat_deg] }, properties: {} })));
  }

  private drawGrid(): void {
    const camera = this.state.shown?.camera;
    if (this.origin === null && camera !== null && camera !== undefined) this.origin = { lat: camera.lat_deg, lon: camera.lon_deg };
    const bounds = this.map.getBounds();
    if (this.origin === null || this.map.getZoom() < 8) { this.set("grid", []); say(byId("grid-step"), ""); return; }
    const { step, lines } = gridLines(this.origin, [bounds.getWest(), bounds.getSouth(), bounds.getEast(), bounds.getNorth()]);
    say(byId("grid-step"), `grid ${distance(step).replace(".0", "")}`);
    this.set("grid", lines.map((line) => ({ type: "Feature", geometry: { type: "LineString", coordinates: line.ends }, properties: { major: line.isMajor } })));
  }

  private paintTheme(): void {
    const p = PALETTES[this.theme], map = this.map;
    map.setPaintProperty("background", "background-color", p.ground);
    map.setPaintProperty("grid", "line-color", ["case", ["get", "major"], p.major, p.grid]);
    map.setPaintProperty("names", "text-color", p.text);
    map.setPaintProperty("names", "text-halo-color", p.halo);
  }

  private colour(): string {
    const at = this.state.vehicles.findIndex((vehicle) => vehicle.id === this.state.vehicle);
    return AIRCRAFT[Math.max(at, 0) % AIRCRAFT.length]!;
  }
}

/** What the map has of a pin: one place, or each of those that contradict each other. */
interface MapPin { readonly pin: Pin; readonly isMarked: boolean; readonly keys: string[]; readonly pins: Feature[]; readonly ellipses: Feature[] }

function mapPin(pin: Pin, isMarked: boolean, isSmall: boolean): MapPin {
  const pins: Feature[] = [], ellipses: Feature[] = [];
  placesOf(pin).forEach((place, k) => {
    const key = `${pin.id}/${k}`;
    pins.push({
      type: "Feature", geometry: { type: "Point", coordinates: [place.lon_deg, place.lat_deg] },
      properties: { key, id: pin.id, small: isSmall, colour: kindOf(pin.category).colour, icon: `${pin.category}${isMarked ? "-marked" : ""}`, label: `${pin.number}${pin.place.status === "ok" ? "" : "!"}`, name: pin.name, order: isMarked ? 1e9 : pin.number },
    });
    const e = place.ellipse;
    if (e !== null && !isSmall) {
      const ring = ellipseRing(place.lat_deg, place.lon_deg, e.semi_major_m, e.semi_minor_m, e.azimuth_deg);
      ellipses.push({ type: "Feature", geometry: { type: "Polygon", coordinates: [ring] }, properties: { key, colour: kindOf(pin.category).colour } });
    }
  });
  return { pin, isMarked, keys: pins.map((feature) => String(feature.properties["key"])), pins, ellipses };
}

function placesOf(pin: Pin): PlaceAnswer[] {
  return pin.place.status === "ok" ? [pin.place] : pin.place.status === "contradiction" ? pin.place.answers : [];
}

function collection(features: Feature[]): Parameters<GeoJSONSource["setData"]>[0] {
  return { type: "FeatureCollection", features } as unknown as Parameters<GeoJSONSource["setData"]>[0];
}

function emptyStyle(tiles: Tiles | null): StyleSpecification {
  const style: StyleSpecification = { version: 8, sources: {}, layers: [{ id: "background", type: "background", paint: { "background-color": "#eef1f4" } }] };
  if (tiles !== null) {
    style.sources["base"] = baseSource(tiles);
    style.layers.push(...baseLayers(tiles));
  }
  return style;
}

/** The map keeps a copy: the viewer closes its pictures when it forgets them. */
function copied(image: ImageBitmap): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  const scale = Math.min(1, 640 / image.width);
  canvas.width = Math.max(Math.round(image.width * scale), 1);
  canvas.height = Math.max(Math.round(image.height * scale), 1);
  canvas.getContext("2d")?.drawImage(image, 0, 0, canvas.width, canvas.height);
  return canvas;
}

function icon(path: string, colour: string, isMarked: boolean, isLine = false): ImageData {
  const side = (isMarked ? 1.3 : 1) * PIN_ICON * 2;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = Math.round(side);
  const context = canvas.getContext("2d")!;
  context.scale(canvas.width / 28, canvas.height / 28);
  context.translate(2, 2);
  const shape = new Path2D(path);
  context.lineJoin = "round";
  context.strokeStyle = isMarked ? "#000" : "#fff";
  context.lineWidth = isMarked || isLine ? 4 : 2.5;
  context.stroke(shape);
  if (isLine) {
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.stroke(shape);
  } else {
    if (isMarked) { context.strokeStyle = "#fff"; context.lineWidth = 2; context.stroke(shape); }
    context.fillStyle = colour;
    context.fill(shape);
  }
  return context.getImageData(0, 0, canvas.width, canvas.height);
}
