// The map pane: works with no tiles at all; grid, flight paths, footprint, features, pictures on the ground, pins and ties.

import * as maplibregl from "maplibre-gl";
import type { GeoJSONSource, ImageSource, Map as MapLibreMap, RasterTileSource, VectorTileSource } from "maplibre-gl";
import { Protocol } from "pmtiles";
import type { BaseMap } from "./base-map.js";
import { byId, setText } from "./dom.js";
import { gridLines } from "./grid.js";
import { onGround } from "./ground-picture.js";
import { degrees, stepText } from "./format.js";
import { ABOVE_PICTURES, addLayers, collection, emptyStyle, paintTheme, PIN_LAYERS, type SourceName } from "./map-layers.js";
import { spotFeatures, trackFeatures } from "./map-tracks.js";
import { dotsOf, mapPin, placesOf, type Feature, type MapPin } from "./map-pins.js";
import { DrawingTime } from "./drawing-time.js";
import { FireLayer } from "./fire.js";
import { SeenLayer, type OpenSeen } from "./seen.js";
import { AIRCRAFT } from "./shapes.js";
import type { State } from "./state.js";
import type { Viewer } from "./viewer.js";
import type { AreaView, FrameView, Pin } from "./types.js";

export { baseMap } from "./base-map.js";

declare const WORKER_URL: string;

const LAID_PICTURES = 16;
const MOST_DRAWN = 500; // with more pins in view than this all but the chosen one are dots
const VIEW_STORED = "pointclick.view";
// Between two drawings of the same: pictures may come faster than a map is worth drawing. Where drawing takes long, as
// without a graphics card, the map rests so many times as long, at most this long: what is clicked is the picture.
const REST_MS = 600, REST_SHARE = 9, LONGEST_REST_MS = 4000;
const ASIDE = 0.15; // of the map's smaller side
const SNAPSHOT_MS = 2500; // that a picture of the map waits for tiles
type What = "shown" | "pins" | "path" | "tracks";
// Delays of drawing the map after the last change, and after the first one: pins once the clicking pauses.
const LATER_MS = 120, LATEST_MS: Record<What, number> = { shown: 500, pins: 10_000, path: 3000, tracks: 1000 };

export class MapPane {
  private readonly map: MapLibreMap;
  private readonly laid = new Map<string, { source: string; layer: string; view: FrameView }>();
  private isReady = false;
  private isFollowing = true;
  private hasView = false;
  private theme: "day" | "night" = "day";
  private readonly drawnAt = new Map<What, number>();
  private readonly texts = new Map<SourceName, string>();
  private restsUntil = 0;
  private readonly waiting = new Map<What, { timer: number; latest: number }>();
  private shownPaths: unknown[] = [];
  private readonly onMap = new Map<string, MapPin>();
  private dots: ReadonlyMap<string, Pin> = new Map();
  private shownCount = 0;
  private isSnapshot = false;
  private origin: { lat: number; lon: number } | null = null;

  constructor(private readonly state: State, private readonly viewer: Viewer, private readonly base: BaseMap | null, private readonly openSeen: OpenSeen) {
    maplibregl.setWorkerUrl(WORKER_URL);
    if (base !== null && base.archive !== null) {
      const protocol = new Protocol();
      protocol.add(base.archive);
      maplibregl.addProtocol("pmtiles", protocol.tile);
    }
    this.map = new maplibregl.Map({
      container: byId("map"),
      style: emptyStyle(base),
      center: [0, 0],
      zoom: 1,
      maxZoom: 24,
      maxPitch: 0,
      dragRotate: true,
      attributionControl: base === null ? false : { compact: true },
      fadeDuration: 0,
      canvasContextAttributes: { antialias: false, preserveDrawingBuffer: false },
    });
    this.map.touchZoomRotate.enable();
    this.map.addControl(new maplibregl.NavigationControl({ showCompass: true }), "top-right");
    this.map.addControl(new maplibregl.ScaleControl({ unit: "metric" }), "bottom-left");
    this.map.on("dragstart", () => this.follow(false));
    this.map.once("load", () => this.ready());
    this.map.on("error", (event) => { console.debug("map", event.error.message); });
    this.begin();
    byId("follow").addEventListener("click", () => this.follow(!this.isFollowing));
    byId("fit").addEventListener("click", () => this.fit());
  }

  setTheme(theme: "day" | "night"): void {
    this.theme = theme;
    if (this.isReady) paintTheme(this.map, this.theme);
  }

  resize(): void { this.map.resize(); }

  /** What the map shows, and the zoom of the tiles that it shows it with. */
  view(): AreaView {
    const bounds = this.map.getBounds(), isVector = this.base?.source.type === "vector";
    const zoom = isVector ? Math.floor(this.map.getZoom()) : Math.round(this.map.getZoom() + 1); // 256 px instead of 512
    return { west: bounds.getWest(), south: bounds.getSouth(), east: bounds.getEast(), north: bounds.getNorth(), zoom: Math.max(zoom, 0) };
  }

  /** From now on tiles come from what was downloaded, else from the address. False: only after the page is loaded again. */
  useKept(isVector: boolean): boolean {
    const source = this.map.getSource("base") as RasterTileSource | VectorTileSource | undefined;
    if (source === undefined || source.type !== (isVector ? "vector" : "raster")) return false;
    source.setTiles([`${location.origin}/tiles/{z}/{x}/{y}`]);
    return true;
  }

  /** Bring a place into view. */
  goTo(lat: number, lon: number): void {
    this.follow(false);
    if (!this.map.getBounds().contains([lon, lat])) this.map.easeTo({ center: [lon, lat], duration: 300 });
  }

  private follow(on: boolean): void {
    this.isFollowing = on;
    byId("follow").setAttribute("aria-pressed", String(on));
    if (on) this.centre(this.state.shown);
  }

  /** About what is brought into view; with more than half of a small map there would be no place that fits. */
  private padding(): number {
    const { clientWidth: width, clientHeight: height } = this.map.getCanvas();
    return Math.min(60, 0.2 * Math.min(width, height));
  }

  private fit(): void {
    const bounds = new maplibregl.LngLatBounds();
    for (const pin of this.state.pins.values()) for (const p of placesOf(pin)) bounds.extend([p.lon_deg, p.lat_deg]);
    for (const place of this.state.paths.get(this.state.vehicle ?? "") ?? []) bounds.extend(place);
    for (const place of this.state.shown?.footprint ?? []) bounds.extend(place);
    this.follow(false);
    if (!bounds.isEmpty()) this.map.fitBounds(bounds, { padding: this.padding(), maxZoom: 20, duration: 300 });
  }

  /** Until the first picture: where there are tiles, else what was looked at last. */
  private begin(): void {
    if (this.base?.bounds != null) {
      this.map.fitBounds(this.base.bounds, { padding: 20, duration: 0 });
      if (this.map.getZoom() < this.base.minZoom) this.map.setZoom(this.base.minZoom);
      return;
    }
    try {
      const [lon, lat, zoom] = JSON.parse(localStorage.getItem(VIEW_STORED) ?? "[]") as number[];
      if (lon !== undefined && lat !== undefined && zoom !== undefined) this.map.jumpTo({ center: [lon, lat], zoom });
    } catch { /* the world, then */ }
  }

  private ready(): void {
    this.isReady = true;
    const map = this.map;
    addLayers(map, this.base);
    new FireLayer(map, "track-areas");
    const seen = new SeenLayer(map, this.state, this.openSeen, () => this.follow(false));
    map.on("moveend", () => this.moved());
    map.on("render", () => {
      const shown = String(this.shownCount), element = byId("map"); // what a test may wait for
      if (element.dataset["pins"] !== shown && map.isSourceLoaded("pins") && map.isSourceLoaded("dots")) element.dataset["pins"] = shown;
    });
    new DrawingTime(map, (tookMs) => {
      const now = performance.now();
      this.restsUntil = Math.min(Math.max(this.restsUntil, now) + REST_SHARE * tookMs, now + LONGEST_REST_MS);
    });
    map.on("mousemove", (event) => setText(byId("map-cursor"), degrees(event.lngLat.lat, event.lngLat.lng, null)));
    map.on("mouseout", () => setText(byId("map-cursor"), ""));
    map.on("mousemove", PIN_LAYERS, (event) => { this.state.hover(String(event.features?.[0]?.properties["id"] ?? "")); map.getCanvas().style.cursor = "pointer"; });
    map.on("mouseleave", PIN_LAYERS, () => { this.state.hover(null); map.getCanvas().style.cursor = ""; });
    map.on("click", PIN_LAYERS, (event) => { if (!seen.isDrawing) this.state.select(String(event.features?.[0]?.properties["id"] ?? "")); });
    paintTheme(this.map, this.theme);
    this.state.on(["shown"], () => this.later("shown"));
    this.state.on(["pins", "hover", "selected"], () => this.later("pins"));
    this.state.on(["frames", "vehicles"], () => this.later("path"));
    this.state.on(["options"], () => this.later("shown"));
    this.state.on(["tracks", "spots", "shown"], () => this.later("tracks"));
    for (const what of ["shown", "pins", "path", "tracks"] as const) this.later(what);
  }

  private moved(): void {
    if (this.isSnapshot) return;
    this.drawGrid();
    // Of very many pins those that have come into view are shown complete, if they are few enough.
    if (this.state.pins.size > MOST_DRAWN) this.later("pins");
    const { lng, lat } = this.map.getCenter();
    try {
      localStorage.setItem(VIEW_STORED, JSON.stringify([lng, lat, this.map.getZoom()]));
    } catch { /* a private window keeps nothing */ }
  }

  /** A picture of the map about a place, north up, some times its radius wide; null if there is no map. */
  async snapshot(lat: number, lon: number, radiusM: number): Promise<string | null> {
    if (!this.isReady || this.isSnapshot) return null;
    const map = this.map, before = { center: map.getCenter(), zoom: map.getZoom(), bearing: map.getBearing() };
    this.isSnapshot = true;
    paintTheme(map, "day"); // it is printed
    try {
      const metres = 40_075_017 * Math.cos(lat * Math.PI / 180) / 512, side = Math.min(map.getCanvas().clientWidth, map.getCanvas().clientHeight);
      map.jumpTo({ center: [lon, lat], zoom: Math.min(Math.log2(metres * side / (2 * radiusM)), 19), bearing: 0 });
      this.drawGrid();
      await new Promise<void>((done) => { map.once("idle", () => done()); window.setTimeout(done, SNAPSHOT_MS); });
      map.redraw();
      return map.getCanvas().toDataURL("image/png");
    } finally {
      map.jumpTo(before);
      this.isSnapshot = false;
      paintTheme(map, this.theme);
      this.drawGrid();
    }
  }

  /** After the picture and its answer, which are waited for: once nothing more comes, or at last after a while. */
  private later(what: What): void {
    const now = performance.now(), held = this.waiting.get(what);
    if (held !== undefined) window.clearTimeout(held.timer);
    const latest = held?.latest ?? now + LATEST_MS[what];
    const timer = window.setTimeout(() => requestAnimationFrame(() => {
      if (this.waiting.get(what)?.timer !== timer) return; // changed once more since
      // Never between a press and its answer: on a slow machine each click would wait for the map of the one before.
      const isBusy = this.state.clicksUnderWay > 0 && performance.now() < latest;
      if (isBusy || performance.now() < this.restsUntil) { this.later(what); return; }
      this.waiting.delete(what);
      this.drawnAt.set(what, performance.now());
      if (what === "path") this.drawPaths();
      else if (what === "tracks") this.drawTracks();
      else if (what === "shown") this.drawShown();
      else this.drawPins();
    }), Math.max(Math.min(LATER_MS, latest - now), (this.drawnAt.get(what) ?? -REST_MS) + REST_MS - now, this.restsUntil - now, 0));
    this.waiting.set(what, { timer, latest });
  }

  private set(name: SourceName, features: Feature[]): void {
    (this.map.getSource(name) as GeoJSONSource).setData(collection(features));
  }

  /** A few features; the map changes only if they are others than before. */
  private setFew(name: SourceName, features: Feature[]): void {
    const text = JSON.stringify(features);
    if (this.texts.get(name) === text) return;
    this.texts.set(name, text);
    this.set(name, features);
  }

  private drawShown(): void {
    const shown = this.state.shown;
    const isShown = shown !== null && shown.camera !== null;
    const properties = { colour: this.colour() };
    this.setFew("footprint", isShown && shown.footprint.length > 3 ? [{ type: "Feature", geometry: { type: "Polygon", coordinates: [shown.footprint] }, properties }] : []);
    this.setFew("features", isShown && this.state.peeks.has("features") ? shown.features.lonlat.map((at) => ({ type: "Feature", geometry: { type: "Point", coordinates: at }, properties: {} })) : []);
    this.drawCraft();
    this.lay();
    if (this.isFollowing || !this.hasView) this.centre(shown);
    if (this.origin === null) this.drawGrid();
  }

  private centre(shown: FrameView | null): void {
    if (shown === null || shown.footprint.length < 3 || this.isSnapshot) return;
    const bounds = new maplibregl.LngLatBounds();
    for (const place of shown.footprint) bounds.extend(place);
    if (!this.hasView) {
      this.hasView = true;
      this.map.fitBounds(bounds, { padding: this.padding(), maxZoom: 21, duration: 0 });
    } else if (this.isFollowing && this.isAside(bounds.getCenter())) {
      this.map.easeTo({ center: bounds.getCenter(), duration: 250 });
    }
  }

  /** Whether a place has left the middle of the map. If it moved with each picture, the map would never be still. */
  private isAside(place: maplibregl.LngLat): boolean {
    const { clientWidth: width, clientHeight: height } = this.map.getCanvas(), at = this.map.project(place);
    return Math.hypot(at.x - width / 2, at.y - height / 2) > ASIDE * Math.min(width, height);
  }

  /** The last pictures in their places on the ground, the one that is shown on top. */
  private lay(): void {
    const loaded = this.viewer.loaded;
    const isOn = this.state.options.pictures;
    for (const [key, held] of this.laid) {
      if (!isOn || this.laid.size > LAID_PICTURES) {
        this.map.removeLayer(held.layer);
        this.map.removeSource(held.source);
        this.laid.delete(key);
        byId("map").dataset["laid"] = [...this.laid.keys()].join(" ");
      }
    }
    if (!isOn || loaded === null || loaded.image === null) return;
    const { view } = loaded;
    const key = `${view.vehicle}/${view.session}/${view.frame}`;
    const held = this.laid.get(key);
    if (held !== undefined && held.view === view) { this.map.moveLayer(held.layer, ABOVE_PICTURES); return; }
    const made = onGround(loaded.image, view.mesh);
    if (made === null) return;
    const name = `picture ${key}`;
    if (held === undefined) {
      this.map.addSource(name, { type: "image", coordinates: made.corners });
      this.map.addLayer({ id: name, type: "raster", source: name, paint: { "raster-fade-duration": 0, "raster-opacity": 0.95 } }, ABOVE_PICTURES);
    } else this.map.moveLayer(held.layer, ABOVE_PICTURES);
    (this.map.getSource(name) as ImageSource).updateImage({ image: made.canvas, coordinates: made.corners });
    this.laid.set(key, { source: name, layer: name, view });
    byId("map").dataset["laid"] = [...this.laid.keys()].join(" "); // what a test may look at
  }

  /** All aircraft; the chosen one where the picture that is shown was taken, and strong. */
  private drawCraft(): void {
    const { shown, vehicle: chosen, vehicles } = this.state;
    const craft = vehicles.flatMap((vehicle, k): Feature[] => {
      const isChosen = vehicle.id === chosen, camera = isChosen && shown?.vehicle === chosen ? shown.camera : null;
      const at = camera !== null ? [camera.lon_deg, camera.lat_deg] : vehicle.place;
      return at === null ? [] : [{
        type: "Feature", geometry: { type: "Point", coordinates: at },
        properties: { colour: AIRCRAFT[k % AIRCRAFT.length], chosen: isChosen, name: vehicles.length > 1 ? vehicle.id : "" },
      }];
    });
    this.setFew("craft", craft);
  }

  private drawPaths(): void {
    this.drawCraft();
    const { vehicle: chosen, vehicles, paths } = this.state;
    const wanted = [chosen, ...vehicles.map((vehicle) => paths.get(vehicle.id))];
    if (wanted.length === this.shownPaths.length && wanted.every((one, k) => one === this.shownPaths[k])) return; // a status comes every second, and drawing costs
    this.shownPaths = wanted;
    this.set("path", vehicles.flatMap((vehicle, k): Feature[] => {
      const path = paths.get(vehicle.id) ?? [];
      return path.length < 2 ? [] : [{ type: "Feature", geometry: { type: "LineString", coordinates: path }, properties: { colour: AIRCRAFT[k % AIRCRAFT.length], chosen: vehicle.id === chosen } }];
    }));
  }

  private drawTracks(): void {
    const tracks = trackFeatures(this.state.tracksNow()), spots = spotFeatures(this.state.openSpots());
    const labels = [...tracks.labels, ...spots.labels];
    this.setFew("track-areas", [...tracks.areas, ...spots.areas]);
    this.setFew("track-lines", [...tracks.lines, ...spots.lines]);
    this.setFew("track-labels", labels);
    byId("map").dataset["tracks"] = labels.map((label) => String(label.properties["text"])).join("; "); // what a test may look at
  }

  /** The pins that are shown complete: all; or of very many those in view, if few enough, and the chosen one. */
  private wholePins(isCrowded: boolean): readonly Pin[] {
    const { pins, hovered, selected } = this.state;
    if (!isCrowded) return [...pins.values()];
    const bounds = this.map.getBounds(), seen = new Map<string, Pin>();
    for (const pin of pins.values()) {
      if (placesOf(pin).some((place) => bounds.contains([place.lon_deg, place.lat_deg]))) seen.set(pin.id, pin);
      if (seen.size > MOST_DRAWN) { seen.clear(); break; }
    }
    for (const id of [hovered, selected]) {
      const pin = id === null ? undefined : pins.get(id);
      if (pin !== undefined) seen.set(pin.id, pin);
    }
    return [...seen.values()];
  }

  private drawPins(): void {
    const { hovered, selected, pins } = this.state, isCrowded = pins.size > MOST_DRAWN;
    this.drawDots(isCrowded);
    // Only what has changed goes to the map: a pin is the same object until it changes.
    const changed: MapPin[] = [], gone: string[] = [], whole = new Set<string>();
    const isAnew = this.onMap.size === 0;
    for (const pin of this.wholePins(isCrowded)) {
      whole.add(pin.id);
      const isMarked = pin.id === hovered || pin.id === selected, held = this.onMap.get(pin.id);
      if (held !== undefined && held.pin === pin && held.isMarked === isMarked) continue;
      if (held !== undefined) gone.push(...held.keys);
      const made = mapPin(pin, isMarked);
      this.onMap.set(pin.id, made);
      changed.push(made);
    }
    for (const [id, held] of this.onMap) if (!whole.has(id)) { gone.push(...held.keys); this.onMap.delete(id); }
    for (const name of ["pins", "ellipses"] as const) {
      if (isAnew || changed.length > this.onMap.size / 2) this.set(name, [...this.onMap.values()].flatMap((made) => made[name]));
      else if (changed.length > 0 || gone.length > 0) {
        const add = changed.flatMap((made) => made[name]), added = new Set(add.map((feature) => feature.properties["key"]));
        this.update(name, add, gone.filter((key) => !added.has(key)));
      }
    }
    this.shownCount = pins.size;
    this.setFew("ties", this.state.ties.map((tie) => ({ type: "Feature", geometry: { type: "Point", coordinates: [tie.lon_deg, tie.lat_deg] }, properties: {} })));
  }

  /** Very many pins as dots. They have a source of their own: which one is pointed at changes nothing in it. */
  private drawDots(isCrowded: boolean): void {
    const pins = isCrowded ? this.state.pins : new Map<string, Pin>();
    const changed = [...pins.values()].filter((pin) => this.dots.get(pin.id) !== pin);
    const gone = [...this.dots.values()].filter((pin) => pins.get(pin.id) !== pin).flatMap((pin) => dotsOf(pin).map((dot) => String(dot.properties["key"])));
    if (changed.length === 0 && gone.length === 0) return;
    this.dots = new Map(pins);
    if (changed.length > pins.size / 2 || pins.size === 0) this.set("dots", [...pins.values()].flatMap(dotsOf));
    else {
      const add = changed.flatMap(dotsOf), added = new Set(add.map((feature) => feature.properties["key"]));
      this.update("dots", add, gone.filter((key) => !added.has(key)));
    }
  }

  private update(name: SourceName, add: Feature[], remove: string[]): void {
    (this.map.getSource(name) as GeoJSONSource).updateData({ add, remove } as unknown as Parameters<GeoJSONSource["updateData"]>[0]);
  }

  private drawGrid(): void {
    const camera = this.state.shown?.camera;
    if (this.origin === null && camera !== null && camera !== undefined) this.origin = { lat: camera.lat_deg, lon: camera.lon_deg };
    const bounds = this.map.getBounds();
    if (this.origin === null || this.map.getZoom() < 8) { this.setFew("grid", []); setText(byId("grid-step"), ""); return; }
    const { step, lines } = gridLines(this.origin, [bounds.getWest(), bounds.getSouth(), bounds.getEast(), bounds.getNorth()]);
    setText(byId("grid-step"), `grid ${stepText(step)}`);
    this.setFew("grid", lines.map((line) => ({ type: "Feature", geometry: { type: "LineString", coordinates: line.ends }, properties: { major: line.isMajor } })));
  }

  private colour(): string {
    const at = this.state.vehicles.findIndex((vehicle) => vehicle.id === this.state.vehicle);
    return AIRCRAFT[Math.max(at, 0) % AIRCRAFT.length]!;
  }
}
