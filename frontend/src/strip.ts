// One tile for each aircraft: how it is in words, how old what is seen is, how the link is.

import { byId, make, say } from "./dom.js";
import { age, radius } from "./format.js";
import { AIRCRAFT } from "./shapes.js";
import type { State } from "./state.js";
import type { VehicleState } from "./types.js";
import type { Viewer } from "./viewer.js";

const SIGNS = { well: "●", warning: "▲", lost: "✕" } as const;

export class StatusStrip {
  private readonly strip = byId("status-strip");
  private readonly tiles = new Map<string, HTMLButtonElement>();

  constructor(private readonly state: State, private readonly viewer: Viewer) {
    state.on(["vehicles", "link"], () => this.draw());
  }

  private draw(): void {
    this.state.vehicles.forEach((vehicle, k) => {
      let tile = this.tiles.get(vehicle.id);
      if (tile === undefined) {
        tile = make("button", { type: "button", class: "craft", "data-vehicle": vehicle.id, click: () => this.viewer.choose(vehicle.id) },
          make("i", { class: "swatch" }), make("span", { class: "sign" }), make("strong", {}, vehicle.id),
          make("span", { class: "words" }), make("span", { class: "figures" }));
        (tile.firstElementChild as HTMLElement).style.background = AIRCRAFT[k % AIRCRAFT.length]!;
        this.tiles.set(vehicle.id, tile);
        this.strip.append(tile);
      }
      const isUnsure = vehicle.is_live && !this.state.isConnected;
      tile.dataset["state"] = isUnsure ? "lost" : vehicle.state;
      tile.setAttribute("aria-pressed", String(vehicle.id === this.state.vehicle));
      say(tile.children[1] as HTMLElement, SIGNS[isUnsure ? "lost" : vehicle.state]);
      say(tile.children[3] as HTMLElement, isUnsure ? "server not reached" : vehicle.words);
      say(tile.children[4] as HTMLElement, figures(vehicle));
      tile.title = [vehicle.words, vehicle.trouble].filter((text) => text !== "").join("; ");
    });
    byId("no-vehicles").hidden = this.state.vehicles.length > 0;
  }
}

function figures(v: VehicleState): string {
  const parts: string[] = [];
  if (v.is_live) parts.push(v.is_lost ? `lost ${age(v.heard_age_s)} ago` : `picture ${age(v.picture_age_s)} old`);
  if (v.sets_hz !== null && !v.is_lost) parts.push(`${v.sets_hz.toFixed(1)} /s, ${v.kbit_s ?? 0} kbit/s`);
  parts.push(`${v.tracks ?? v.features} tracks`);
  if (v.ce90_centre_m !== null) parts.push(`±${radius(v.ce90_centre_m)} at the centre`);
  if (v.cpu_c !== null) parts.push(`computer ${v.cpu_c.toFixed(0)} °C`);
  if (v.recording === true) parts.push("recording");
  return parts.join(" · ");
}
