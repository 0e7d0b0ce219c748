// One tile for each aircraft: how it is in words, how old what is seen is, how the link is. Of many the tiles are small.

import { byId, make, setText } from "./dom.js";
import { GROUPS, groupTitle, isWanted, MANY } from "./fleet.js";
import { age, sentence, within } from "./format.js";
import { AIRCRAFT } from "./shapes.js";
import type { State } from "./state.js";
import type { VehicleState } from "./types.js";
import type { Viewer } from "./viewer.js";

const SIGNS = { well: "●", warning: "▲", lost: "✕" } as const;
const FEW = 2; // of more than that only the chosen one has its figures

export class StatusStrip {
  private readonly strip = byId("status-strip");
  private readonly tiles = new Map<string, HTMLButtonElement>();
  private readonly find = byId<HTMLInputElement>("find-aircraft");
  private readonly titles = GROUPS.map((group) => make("span", { class: "group", "data-group": group }));

  constructor(private readonly state: State, private readonly viewer: Viewer) {
    this.strip.append(...this.titles);
    this.find.addEventListener("input", () => this.draw());
    state.on(["vehicles", "link"], () => this.draw());
  }

  private draw(): void {
    const { vehicles } = this.state;
    this.strip.classList.toggle("many", vehicles.length > FEW);
    const isGrouped = vehicles.length > MANY, text = isGrouped ? this.find.value.trim() : "";
    this.find.hidden = !isGrouped;
    this.titles.forEach((title, k) => {
      setText(title, isGrouped ? groupTitle(GROUPS[k]!, vehicles, text) : "");
      title.style.order = String(2 * k);
    });
    vehicles.forEach((vehicle, k) => {
      let tile = this.tiles.get(vehicle.id);
      if (tile === undefined) {
        tile = make("button", { type: "button", class: "craft", "data-vehicle": vehicle.id, click: () => this.viewer.choose(vehicle.id) },
          make("i", { class: "swatch" }), make("span", { class: "sign" }), make("strong", {}, vehicle.id),
          make("span", { class: "words" }), make("span", { class: "advice" }), make("span", { class: "figures" }));
        (tile.firstElementChild as HTMLElement).style.background = AIRCRAFT[k % AIRCRAFT.length]!;
        this.tiles.set(vehicle.id, tile);
        this.strip.append(tile);
      }
      const isUnsure = vehicle.is_live && !this.state.isConnected, isChosen = vehicle.id === this.state.vehicle;
      const words = isUnsure ? "server not reached" : vehicle.words, isShort = vehicles.length > FEW && !isChosen;
      tile.hidden = !isChosen && !isWanted(vehicle, text);
      tile.style.order = isGrouped && !isChosen ? String(2 * GROUPS.indexOf(vehicle.state) + 1) : "";
      tile.dataset["state"] = isUnsure ? "lost" : vehicle.state;
      tile.setAttribute("aria-pressed", String(isChosen));
      setText(tile.children[1] as HTMLElement, SIGNS[isUnsure ? "lost" : vehicle.state]);
      setText(tile.children[3] as HTMLElement, isShort ? "" : words);
      const advice = isUnsure || vehicle.state !== "well" || vehicle.radius === "" ? "" : sentence(vehicle.radius);
      setText(tile.children[4] as HTMLElement, isShort ? "" : advice);
      setText(tile.children[5] as HTMLElement, isShort ? shortFigure(vehicle) : figures(vehicle));
      tile.title = [vehicle.id, words, vehicle.trouble, figures(vehicle), advice].filter((text) => text !== "").join("; ");
    });
    byId("no-vehicles").hidden = vehicles.length > 0;
  }
}

function shortFigure(v: VehicleState): string {
  if (!v.is_live) return "recorded";
  return v.is_lost ? `lost ${age(v.heard_age_s)}` : age(v.picture_age_s);
}

function figures(v: VehicleState): string {
  const parts: string[] = [];
  if (v.is_live) parts.push(v.is_lost ? `lost ${age(v.heard_age_s)} ago` : `picture ${age(v.picture_age_s)} old`);
  if (v.ce90_centre_m !== null) parts.push(`${within(v.ce90_centre_m)} at the centre`);
  if (v.sets_hz !== null && !v.is_lost) parts.push(`${v.sets_hz.toFixed(1)} /s, ${v.kbit_s ?? 0} kbit/s`);
  if (v.person_found !== null) parts.push(`a person would be found on ${Math.floor(100 * v.person_found)} %`);
  parts.push(`${v.tracks ?? v.features} points`);
  if (v.cpu_c !== null) parts.push(`computer ${v.cpu_c.toFixed(0)} °C`);
  if (v.recording === true) parts.push("recording");
  return parts.join(" · ");
}
