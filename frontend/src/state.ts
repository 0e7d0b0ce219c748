// The page's state, in one place, and the functions that are called when it changes.

import { captureMs, mergeReports, tracksAt, type TrackNow } from "./tracks.js";
import type { Category, FoundSpot, FrameRow, FrameView, News, Pin, ServerStatus, Tie, TrackReport, VehicleState } from "./types.js";

export type Topic = "vehicles" | "frames" | "shown" | "pins" | "hover" | "selected" | "options" | "link" | "mode" | keyof News;

/** What the next click in the picture is for. */
export type Mode = { kind: "pin" } | { kind: "again"; pin: string } | { kind: "tie" };

/** What is shown over the picture for a few seconds when asked for: it hides what is looked for. */
export type Peek = "features" | "paths";

/** What is large: the picture, the map, or both as large. */
export type Large = "picture" | "both" | "map";
export const LARGE: readonly Large[] = ["picture", "both", "map"];

/** How coordinates are written. */
export type Form = "degrees" | "minutes" | "seconds" | "mgrs" | "utm";

export interface Options {
  isMuted: boolean; pictures: boolean; theme: "auto" | "day" | "night"; who: string; category: Category;
  view: Large; form: Form;
}

const STORED = "pointclick.options";
const PEEK_MS = 6000;
const DEFAULTS: Options = { isMuted: false, pictures: true, theme: "auto", who: "", category: "poi", view: "picture", form: "degrees" };

export class State {
  server: ServerStatus | null = null;
  vehicles: VehicleState[] = [];
  vehiclesAt = 0; // by performance.now(), when they were received
  vehicle: string | null = null;
  readonly frames = new Map<string, FrameRow[]>();
  readonly paths = new Map<string, [number, number][]>();
  shown: FrameView | null = null;
  isFrozen = false;
  isPlaying = false;
  private readonly held = new Map<string, Pin>();
  // By id, deleted ones too: the revision of the server's pins at which each was read. Events and replies may overtake each other.
  private readonly revisions = new Map<string, number>();
  private order: Pin[] | null = null;
  ties: Tie[] = [];
  readonly spots = new Map<number, FoundSpot>();
  readonly tracks = new Map<string, TrackReport[]>();
  private readonly merging: { readonly [K in keyof News]: (news: readonly News[K][]) => void } = {
    tracks: (reports) => { mergeReports(this.tracks, reports); },
    spots: (spots) => { for (const spot of spots) this.spots.set(spot.spot, spot); },
  };
  hovered: string | null = null;
  selected: string | null = null;
  isConnected = false;
  clicksUnderWay = 0;
  mode: Mode = { kind: "pin" };
  options: Options = stored();

  readonly peeks = new Map<Peek, number>();
  private readonly listeners = new Map<Topic, (() => void)[]>();

  on(topics: Topic[], listener: () => void): void {
    for (const topic of topics) this.listeners.set(topic, [...(this.listeners.get(topic) ?? []), listener]);
  }

  notify(topic: Topic): void {
    for (const listener of this.listeners.get(topic) ?? []) listener();
  }

  /** The pictures of the vehicle that is looked at, in capture order. */
  rows(): FrameRow[] {
    return this.vehicle === null ? [] : this.frames.get(this.vehicle) ?? [];
  }

  /** Take rows that came: those of a new session begin a new list. */
  merge(vehicle: string, rows: FrameRow[]): void {
    const held = this.frames.get(vehicle) ?? [];
    const session = rows.at(-1)?.session;
    const by = new Map(held.filter((row) => row.session === session).map((row) => [row.frame, row]));
    for (const row of rows) by.set(row.frame, row);
    const merged = [...by.values()].sort((a, b) => a.frame - b.frame);
    this.frames.set(vehicle, merged);
    this.notify("frames");
  }

  get pins(): ReadonlyMap<string, Pin> { return this.held; }

  /** All pins, the newest number first. */
  newestFirst(): readonly Pin[] {
    this.order ??= [...this.held.values()].sort((a, b) => b.number - a.number);
    return this.order;
  }

  /** All pins as read at a revision, but for those of which something newer is known. */
  setPins(pins: Pin[], revision: number): void {
    const read = new Map(pins.map((pin) => [pin.id, pin]));
    for (const id of this.held.keys()) if (!read.has(id) && this.isNews(id, revision)) this.held.delete(id);
    for (const [id, pin] of read) if (this.isNews(id, revision)) this.held.set(id, pin);
    this.order = null;
    this.notify("pins");
  }

  /** Another server may answer from now on, whose revisions have another start. */
  forgetRevisions(): void { this.revisions.clear(); }

  /** Whether nothing newer is known of a pin; stores the revision if so. */
  private isNews(id: string, revision: number): boolean {
    if (revision < (this.revisions.get(id) ?? revision)) return false;
    this.revisions.set(id, revision);
    return true;
  }

  /** One pin as it is now. What is known already, as a click of one's own that comes again as an event, changes nothing. */
  putPin(pin: Pin, revision: number): void {
    if (!this.isNews(pin.id, revision)) return;
    const known = this.held.get(pin.id);
    if (known !== undefined && JSON.stringify(known) === JSON.stringify(pin)) return;
    this.held.set(pin.id, pin);
    if (known === undefined && this.order !== null && (this.order[0]?.number ?? 0) < pin.number) this.order = [pin, ...this.order];
    else this.order = null;
    this.notify("pins");
  }

  dropPin(id: string, revision: number): void {
    if (!this.isNews(id, revision)) return;
    this.held.delete(id);
    this.order = null;
    if (this.selected === id) this.select(null);
    this.notify("pins");
  }

  /** Whether this browser's token may change anything. */
  get mayChange(): boolean { return this.server?.role !== "viewer"; }

  /** What came of a view of the server; with all of it, what was held is forgotten first. */
  put<K extends keyof News>(what: K, news: readonly News[K][], isAll = false): void {
    if (isAll) this[what].clear();
    this.merging[what](news);
    this.notify(what);
  }

  /** Those that wait for a person: more than one picture shows them. The hottest first. */
  openSpots(): FoundSpot[] {
    return [...this.spots.values()].filter((spot) => spot.state === "open" && spot.is_sure)
      .sort((a, b) => (b.probability ?? -1) - (a.probability ?? -1) || (b.temperature_c ?? -1e9) - (a.temperature_c ?? -1e9) || Math.abs(b.contrast) - Math.abs(a.contrast));
  }

  /** What is followed, as it is now; of a recording or a picture that is kept, as it was then. */
  tracksNow(): TrackNow[] {
    return this.tracks.size === 0 ? [] : tracksAt(this.tracks, (vehicle) => this.momentMs(vehicle));
  }

  /** The moment that is looked at (ms since 1970), by an aircraft's clock. */
  private momentMs(vehicle: string): number {
    const state = this.vehicles.find((one) => one.id === vehicle), clock = state?.clock_unix_ns ?? null;
    const isThen = this.isFrozen || state?.is_live === false;
    if (isThen && this.shown !== null) return captureMs(this.shown.capture_unix_ns);
    // What has come is of now, whatever the time of the last status.
    const newest = [...this.tracks.values()].filter((path) => path[0]?.vehicle === vehicle).map((path) => captureMs(path.at(-1)!.capture_unix_ns));
    return Math.max(clock === null ? 0 : captureMs(clock) + (state?.is_live === true ? performance.now() - this.vehiclesAt : 0), ...newest);
  }

  hover(pin: string | null): void {
    if (this.hovered !== pin) { this.hovered = pin; this.notify("hover"); }
  }

  select(pin: string | null): void {
    if (this.selected !== pin) { this.selected = pin; this.notify("selected"); }
  }

  /** Draw it for a few seconds; if it is shown already, remove it. */
  peek(what: Peek): void {
    const timer = this.peeks.get(what);
    window.clearTimeout(timer);
    if (timer !== undefined) this.peeks.delete(what);
    else this.peeks.set(what, window.setTimeout(() => { this.peeks.delete(what); this.notify("options"); }, PEEK_MS));
    this.notify("options");
  }

  setVehicles(vehicles: VehicleState[]): void {
    this.vehicles = vehicles.sort((a, b) => a.id.localeCompare(b.id, "en", { numeric: true }));
    this.vehiclesAt = performance.now();
  }

  setMode(mode: Mode): void {
    this.mode = mode;
    this.notify("mode");
  }

  set(changed: Partial<Options>): void {
    this.options = { ...this.options, ...changed };
    try {
      localStorage.setItem(STORED, JSON.stringify(this.options));
    } catch { /* a private window keeps nothing: the options last as long as the page */ }
    this.notify("options");
  }

  /** The number the next pin will get, as far as this page has the data. */
  nextNumber(): number {
    return (this.newestFirst()[0]?.number ?? 0) + 1;
  }
}

function stored(): Options {
  try {
    const kept = JSON.parse(localStorage.getItem(STORED) ?? "{}") as Partial<Options>;
    return { ...DEFAULTS, ...kept };
  } catch {
    return { ...DEFAULTS };
  }
}
