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
  pins = new Map<string, Pin>();
  ties: Tie[] = [];
  hovered: string | null = null;
  selected: string | null = null;
  isConnected = false;
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
    let most = 0;
    for (const pin of this.pins.values()) most = Math.max(most, pin.number);
    return most + 1;
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
