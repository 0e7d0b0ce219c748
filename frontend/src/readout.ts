// The place under the cursor, the loupe or the crosshair, and how sure it is, before anything is clicked.

import { api } from "./api.js";
import { byId, setText } from "./dom.js";
import { degrees, heightText, within } from "./format.js";
import type { State } from "./state.js";
import type { ClickBody, PlaceReply } from "./types.js";

const REST_MS = 60; // between two questions; and none while a click is under way

export class Readout {
  private readonly element = byId("readout");
  private wanted: ClickBody | null = null;
  private isAsking = false;

  constructor(private readonly state: State) {}

  /** What is pointed at; null: nothing. */
  point(at: ClickBody | null): void {
    this.wanted = at;
    if (at === null) this.element.hidden = true;
    else if (!this.isAsking) void this.ask();
  }

  private async ask(): Promise<void> {
    this.isAsking = true;
    let asked: ClickBody | null = null;
    while (this.wanted !== null && this.wanted !== asked) {
      if (this.state.clicksUnderWay === 0) {
        asked = this.wanted;
        try {
          const reply = await api.place(asked);
          if (this.wanted !== null) { this.element.hidden = false; setText(this.element, placeWords(reply)); }
        } catch {
          this.element.hidden = true; // the page shows elsewhere that the server does not answer
        }
      }
      await new Promise((rest) => window.setTimeout(rest, REST_MS));
    }
    this.isAsking = false;
  }
}

function placeWords(reply: PlaceReply): string {
  if (reply.status !== "ok") return `no place here: ${reply.reason ?? "not answered"}`;
  return `${degrees(reply.lat_deg, reply.lon_deg, reply.ce90_m)}  ${within(reply.ce90_m)}  ${heightText(reply)}`;
}
