// One pill for each aircraft: green, amber or red, its name and how old what is seen is. Words when it is pressed.

import { byId, make, setText } from "./dom.js";
import { GROUPS, groupTitle, isWanted, MANY } from "./fleet.js";
import { age, distance, sentence, within } from "./format.js";
import type { Looking } from "./looking.js";
import { AIRCRAFT } from "./shapes.js";
import type { State } from "./state.js";
import type { VehicleState } from "./types.js";
import type { Viewer } from "./viewer.js";

const SIGNS = { well: "●", warning: "▲", lost: "✕" } as const;
const AHEAD = ": ahead: accepted"; // as the aircraft words it
const FEW = 4; // more have a line of their own

export class StatusStrip {
  private readonly strip = byId("status-strip");
  private readonly card = byId("craft-card");
  private readonly tiles = new Map<string, HTMLButtonElement>();
  private readonly find = byId<HTMLInputElement>("find-aircraft");
  private readonly titles = GROUPS.map((group) => make("span", { class: "group", "data-group": group }));
  private opened: string | null = null; // the aircraft whose card is open

  constructor(private readonly state: State, private readonly viewer: Viewer, private readonly looking: Looking) {
    this.strip.append(...this.titles);
    this.find.addEventListener("input", () => this.draw());
    state.on(["vehicles", "link"], () => this.draw());
    document.addEventListener("pointerdown", (event) => {
      const at = event.target as Node;
      if (!this.card.contains(at) && !this.strip.contains(at)) this.open(null);
    });
    document.addEventListener("keydown", (event) => { if (event.key === "Escape") this.open(null); });
  }

  /** A press chooses an aircraft; on the chosen one it opens or closes its card. */
  private pressed(vehicle: string): void {
    if (this.state.vehicle === vehicle) { this.open(this.opened === vehicle ? null : vehicle); return; }
    this.opened = null;
    this.viewer.choose(vehicle);
  }

  private open(vehicle: string | null): void {
    if (this.opened === vehicle) return;
    this.opened = vehicle;
    this.draw();
  }

  private draw(): void {
    const { vehicles } = this.state;
    document.body.classList.toggle("many-aircraft", vehicles.length > FEW);
    const isGrouped = vehicles.length > MANY, text = isGrouped ? this.find.value.trim() : "";
    this.find.hidden = !isGrouped;
    this.titles.forEach((title, k) => {
      setText(title, isGrouped ? groupTitle(GROUPS[k]!, vehicles, text) : "");
      title.style.order = String(2 * k);
    });
    vehicles.forEach((vehicle, k) => {
      let tile = this.tiles.get(vehicle.id);
      if (tile === undefined) {
        tile = make("button", { type: "button", class: "craft", "data-vehicle": vehicle.id, "aria-controls": "craft-card", click: () => this.pressed(vehicle.id) },
          make("i", { class: "swatch" }), make("span", { class: "sign" }), make("strong", {}, vehicle.id), make("span", { class: "figure" }));
        (tile.firstElementChild as HTMLElement).style.background = AIRCRAFT[k % AIRCRAFT.length]!;
        this.tiles.set(vehicle.id, tile);
        this.strip.append(tile);
      }
      const isChosen = vehicle.id === this.state.vehicle, state = this.stateOf(vehicle);
      tile.hidden = !isChosen && !isWanted(vehicle, text);
      tile.style.order = isGrouped && !isChosen ? String(2 * GROUPS.indexOf(vehicle.state) + 1) : "";
      tile.dataset["state"] = state;
      tile.setAttribute("aria-pressed", String(isChosen));
      tile.setAttribute("aria-expanded", String(this.opened === vehicle.id));
      setText(tile.children[1] as HTMLElement, SIGNS[state]);
      setText(tile.children[3] as HTMLElement, shortFigure(vehicle));
      tile.title = [vehicle.id, ...this.facts(vehicle).map(([, words]) => words)].join("; ");
    });
    byId("no-vehicles").hidden = vehicles.length > 0;
    this.drawCard(vehicles.find((one) => one.id === this.opened && one.id === this.state.vehicle));
  }

  private stateOf(v: VehicleState): VehicleState["state"] { return this.isUnsure(v) ? "lost" : v.state; }

  private isUnsure(v: VehicleState): boolean { return v.is_live && !this.state.isConnected; }

  private facts(v: VehicleState): [string, string][] {
    return facts(v, this.isUnsure(v) ? "server not reached" : v.words);
  }

  private drawCard(v: VehicleState | undefined): void {
    this.card.hidden = v === undefined;
    if (v === undefined) { this.opened = null; return; }
    const mayEnd = v.look !== "" && !v.look.endsWith(AHEAD) && this.looking.may(v.id);
    const rows = this.facts(v), text = JSON.stringify([v.id, rows, mayEnd]);
    this.card.dataset["state"] = this.stateOf(v);
    if (this.card.dataset["shown"] === text) return;
    this.card.dataset["shown"] = text;
    this.card.replaceChildren(make("h2", {}, v.id), make("dl", {}, ...rows.flatMap(([name, words]) => [make("dt", {}, name), make("dd", {}, words)])),
      ...(mayEnd ? [make("button", { type: "button", "data-testid": "look-ahead", title: "the camera looks at that place no longer", click: () => void this.looking.ahead(v.id) }, "Look ahead")] : []));
  }
}

function shortFigure(v: VehicleState): string {
  if (!v.is_live) return "recorded";
  return v.is_lost ? `lost ${age(v.heard_age_s)}` : age(v.picture_age_s);
}

/** What is known of an aircraft, as names and words. */
function facts(v: VehicleState, state: string): [string, string][] {
  const rows: [string, string | null][] = [
    ["State", state],
    ["Trouble", v.trouble],
    ["Picture", !v.is_live ? null : v.is_lost ? `nothing received for ${age(v.heard_age_s)}` : `${age(v.picture_age_s)} old`],
    ["Height", heights(v)],
    ["GPS", v.gps],
    ["Battery", v.battery],
    ["Mode", v.mode],
    ["Radius", v.ce90_centre_m === null ? null : `${within(v.ce90_centre_m)} at the picture's centre`],
    ["Smaller by", v.state === "well" || !v.is_live ? sentence(v.radius) : null],
    ["Link", v.sets_hz === null || v.is_lost ? null : `${v.sets_hz.toFixed(1)} sets/s, ${v.kbit_s ?? 0} kbit/s`],
    ["Tracking", `${v.tracks ?? v.features} features`],
    ["People", v.person_found === null ? null : `a person would be found on ${Math.floor(100 * v.person_found)} % of the ground in view`],
    ["Camera", v.look],
    ["Computer", v.cpu_c === null ? null : `${v.cpu_c.toFixed(0)} °C`],
    ["Recording", v.recording === null ? null : v.recording ? "yes" : "no"],
  ];
  return rows.filter((row): row is [string, string] => row[1] !== null && row[1] !== "");
}

/** Of the newest picture. */
function heights(v: VehicleState): string | null {
  if (v.height_above_ground_m === null) return null;
  return `${distance(v.height_above_ground_m)} above the ground in view${v.height_amsl_m === null ? "" : `, ${v.height_amsl_m.toFixed(0)} m above sea level`}`;
}
