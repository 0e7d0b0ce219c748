// Marks on the time bar: the pictures in which pins were clicked and in which a machine found something.

import { byId, make } from "./dom.js";
import { kindOf } from "./shapes.js";
import type { State } from "./state.js";

const MOST = 200; // the newest pins first
const REST_MS = 500; // a live flight lengthens the bar several times a second
const FOUND_COLOUR = "#ff2d6f";

interface Mark { readonly frame: number; readonly colour: string; readonly kind: "pin" | "find" }

export class TimeMarks {
  private readonly layer = byId("time-marks");
  private timer = 0;
  private shown = "";

  constructor(private readonly state: State) {
    state.on(["pins", "spots", "frames", "vehicles"], () => {
      if (this.timer === 0) this.timer = window.setTimeout(() => { this.timer = 0; this.draw(); }, REST_MS);
    });
  }

  private draw(): void {
    const rows = this.state.rows(), last = rows.length - 1;
    const at = new Map(rows.map((row, k) => [row.frame, k]));
    const marks = last < 1 ? [] : this.marks(rows[0]!.session).filter((mark) => at.has(mark.frame));
    const shown = marks.map((mark) => `${mark.kind} ${mark.frame} ${mark.colour}`).join() + `/${last}`;
    if (shown === this.shown) return;
    this.shown = shown;
    this.layer.replaceChildren(...marks.map(({ frame, colour, kind }) => {
      const mark = make("i", { "data-testid": "time-mark", "data-kind": kind, "data-frame": String(frame) });
      mark.style.background = colour;
      mark.style.setProperty("--at", (at.get(frame)! / last).toFixed(4));
      return mark;
    }));
  }

  /** One for each picture and colour, of the aircraft that is looked at. */
  private marks(session: number): Mark[] {
    const found = new Map<string, Mark>(), vehicle = this.state.vehicle;
    const add = (kind: Mark["kind"], frame: number, colour: string): void => { found.set(`${kind} ${frame} ${colour}`, { kind, frame, colour }); };
    for (const { best } of this.state.openSpots()) if (best.vehicle === vehicle && best.session === session) add("find", best.frame, FOUND_COLOUR);
    for (const pin of this.state.newestFirst()) {
      if (found.size >= MOST) break;
      for (const click of pin.clicks) if (click.vehicle === vehicle && click.session === session && click.frame !== null) add("pin", click.frame, kindOf(pin.category).colour);
    }
    return [...found.values()];
  }
}
