// What the page knows, in one place, and who is told when it changes.

import type { Category, FrameRow, FrameView, Pin, ServerStatus, Tie, VehicleState } from "./types.js";

export type Topic = "vehicles" | "frames" | "shown" | "pins" | "hover" | "selected" | "options" | "link" | "mode";

/** What the next click in the picture is for. */
export type Mode = { kind: "pin" } | { kind: "again"; pin: string } | { kind: "tie" };

export interface Options {
  features: boolean; paths: boolean; pictures: boolean; theme: "auto" | "day" | "night"; who: string; category: Category;
}

const STORED = "pointclick.options";
const DEFAULTS: Options = { features: true, paths: true, pictures: true, theme: "auto", who: "", category: "poi" };

export class State {
  server: ServerStatus | null = null;
  vehicles: VehicleState[] = [];
  vehicle: string | null = null;
  readonly frames = new Map<string, FrameRow[]>();
  readonly paths = new Map<string, [number, number][]>();
  shown: FrameView | null = null;
  isFrozen = false;
  isPlaying = false;
  private readonly held = new Map<string, Pin>();
  private order: Pin[] | null = null;
  ties: Tie[] = [];
  hovered: string | null = null;
  selected: string | null = null;
  isConnected = false;
  clicksUnderWay = 0;
  mode: Mode = { kind: "pin" };
  options: Options = stored();

  private readonly listeners = new Map<Topic, (() => void)[]>();

  on(topics: Topic[], listener: () => void): void {
    for (const topic of topics) this.listeners.set(topic, [...(this.listeners.get(topic) ?? []), listener]);
  }

  tell(topic: Topic): void {
    for (const listener of this.listeners.get(topic) ?? []) listener();
  }

  /** The pictures of the vehicle that is looked at, in capture order. */
  rows(): FrameRow[] {
    return this.vehicle === null ? [] : this.frames.get(this.vehicle) ?? [];
  }

  /** Take rows that came: those of a session heard of first begin anew. */
  merge(vehicle: string, rows: FrameRow[]): void {
    const held = this.frames.get(vehicle) ?? [];
    const session = rows.at(-1)?.session;
    const by = new Map(held.filter((row) => row.session === session).map((row) => [row.frame, row]));
    for (const row of rows) by.set(row.frame, row);
    const merged = [...by.values()].sort((a, b) => a.frame - b.frame);
    this.frames.set(vehicle, merged);
    this.tell("frames");
  }

  get pins(): ReadonlyMap<string, Pin> { return this.held; }

  /** All pins, the newest number first. */
  newestFirst(): readonly Pin[] {
    this.order ??= [...this.held.values()].sort((a, b) => b.number - a.number);
    return this.order;
  }

  setPins(pins: Pin[]): void {
    this.held.clear();
    for (const pin of pins) this.held.set(pin.id, pin);
    this.order = null;
    this.tell("pins");
  }

  /** One pin as it is now. What is known already, as a click of one's own that comes again as an event, changes nothing. */
  putPin(pin: Pin): void {
    const known = this.held.get(pin.id);
    if (known !== undefined && JSON.stringify(known) === JSON.stringify(pin)) return;
    this.held.set(pin.id, pin);
    if (known === undefined && this.order !== null && (this.order[0]?.number ?? 0) < pin.number) this.order = [pin, ...this.order];
    else this.order = null;
    this.tell("pins");
  }

  dropPin(id: string): void {
    this.held.delete(id);
    this.order = null;
    if (this.selected === id) this.select(null);
    this.tell("pins");
  }

  hover(pin: string | null): void {
    if (this.hovered !== pin) { this.hovered = pin; this.tell("hover"); }
  }

  select(pin: string | null): void {
    if (this.selected !== pin) { this.selected = pin; this.tell("selected"); }
  }

  setMode(mode: Mode): void {
    this.mode = mode;
    this.tell("mode");
  }

  set(changed: Partial<Options>): void {
    this.options = { ...this.options, ...changed };
    try {
      localStorage.setItem(STORED, JSON.stringify(this.options));
    } catch { /* a private window keeps nothing: the options last as long as the page */ }
    this.tell("options");
  }

  /** The number the next pin will get, as far as this page knows. */
  nextNumber(): number {
    return (this.newestFirst()[0]?.number ?? 0) + 1;
  }
}

function stored(): Options {
  try {
    const said = JSON.parse(localStorage.getItem(STORED) ?? "{}") as Partial<Options>;
    return { ...DEFAULTS, ...said };
  } catch {
    return { ...DEFAULTS };
  }
}
