// How old what is seen is, on the picture itself: in words, in colour, and counting.

import { byId, setText } from "./dom.js";
import { age } from "./format.js";
import type { State } from "./state.js";
import type { FrameView } from "./types.js";

const LIVE_S = 3;
const TICK_MS = 500;

/** Seconds since a picture was taken, by its aircraft's clock; null where that is not known. Of a recording: before its end. */
export function ageOf(state: State, frame: FrameView): number | null {
  const vehicle = state.vehicles.find((one) => one.id === frame.vehicle);
  if (vehicle === undefined || vehicle.clock_unix_ns === null) return frame.age_s;
  const elapsed = vehicle.is_live ? (performance.now() - state.vehiclesAt) / 1000 : 0;
  return Math.max(Number(BigInt(vehicle.clock_unix_ns) - BigInt(frame.capture_unix_ns)) / 1e9 + elapsed, 0);
}

export class AgeBadge {
  private readonly element = byId("age");

  constructor(private readonly state: State) {
    window.setInterval(() => this.draw(), TICK_MS);
    state.on(["shown", "vehicles", "link"], () => this.draw());
  }

  private draw(): void {
    const shown = this.state.shown;
    this.element.hidden = shown === null;
    if (shown === null) return;
    const [kind, words] = this.words(shown);
    this.element.dataset["kind"] = kind;
    setText(this.element, words);
  }

  private words(shown: FrameView): [string, string] {
    const vehicle = this.state.vehicles.find((one) => one.id === shown.vehicle);
    const seconds = ageOf(this.state, shown), old = seconds === null ? "AGE UNKNOWN" : `${age(seconds)} OLD`;
    if (vehicle !== undefined && !vehicle.is_live) return ["recorded", "RECORDED"];
    if (!this.state.isConnected) return ["lost", `NO SERVER · ${old}`];
    if (vehicle === undefined || vehicle.is_lost) return ["lost", `LOST · ${old}`];
    if (this.state.isFrozen) return ["frozen", `FROZEN · ${old}`];
    return seconds !== null && seconds <= LIVE_S ? ["live", `LIVE ${seconds.toFixed(1)} s`] : ["old", old];
  }
}
