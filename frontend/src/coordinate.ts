// A place's coordinate in the system that the operator has chosen, which this browser remembers.

import { api } from "./api.js";
import { make, setText } from "./dom.js";
import { degrees } from "./format.js";
import type { Form, State } from "./state.js";

export const FORMS: readonly [Form, string][] = [["degrees", "Degrees"], ["minutes", "Minutes"], ["seconds", "Seconds"], ["mgrs", "MGRS"], ["utm", "UTM"]];
const KEPT = 40; // places whose texts are held

export interface Where { lat_deg: number; lon_deg: number; ce90_m: number | null }

export class Coordinates {
  private readonly shown = new Map<HTMLElement, Where>();
  private readonly texts = new Map<string, Promise<Record<string, string>>>();
  private form: Form;

  constructor(private readonly state: State) {
    this.form = state.options.form;
    state.on(["options"], () => {
      if (state.options.form === this.form) return;
      this.form = state.options.form;
      for (const [element, where] of this.shown) if (element.isConnected) void this.fill(element, where); else this.shown.delete(element);
    });
  }

  /** A new element that always has the place in the chosen system. */
  element(where: Where): HTMLElement {
    const element = make("strong", { class: "coordinate", "data-testid": "coordinate" });
    for (const old of this.shown.keys()) if (!old.isConnected) this.shown.delete(old);
    this.shown.set(element, where);
    void this.fill(element, where);
    return element;
  }

  /** The field that chooses the system. */
  choice(): HTMLSelectElement {
    const select = make("select", { "aria-label": "coordinates as", "data-testid": "form" }, ...FORMS.map(([value, title]) => make("option", { value, selected: value === this.form }, title)));
    select.addEventListener("change", () => this.state.set({ form: select.value as Form }));
    return select;
  }

  /** Degrees at once; the others are the server's, whose texts the hand-off has too. */
  private async fill(element: HTMLElement, where: Where): Promise<void> {
    const form = this.form, { lat_deg: lat, lon_deg: lon, ce90_m: ce90 } = where;
    if (form === "degrees") { setText(element, degrees(lat, lon, ce90)); return; }
    const key = `${lat} ${lon} ${ce90}`;
    let asked = this.texts.get(key);
    if (asked === undefined) {
      asked = api.coordinateTexts(lat, lon, ce90);
      this.texts.set(key, asked);
      for (const old of this.texts.keys()) if (this.texts.size > KEPT) this.texts.delete(old); else break;
    }
    try {
      const texts = await asked;
      if (form === this.form) setText(element, texts[form] || degrees(lat, lon, ce90)); // a pole has no UTM
    } catch {
      this.texts.delete(key);
      setText(element, degrees(lat, lon, ce90));
    }
  }
}
