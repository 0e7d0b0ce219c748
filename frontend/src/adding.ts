// Pins from elsewhere: a coordinate that is typed, or a file of places.

import { api, Refused } from "./api.js";
import { byId } from "./dom.js";
import type { CoordinateReply } from "./types.js";
import type { State } from "./state.js";

const PAUSE_MS = 250;

/** A field that takes a coordinate in any form, and shows how it is read while it is typed. */
export class CoordinateField {
  private timer = 0;

  constructor(private readonly input: HTMLInputElement, private readonly echo: HTMLElement) {
    input.addEventListener("input", () => {
      window.clearTimeout(this.timer);
      this.timer = window.setTimeout(() => void this.read().catch(() => undefined), PAUSE_MS);
    });
  }

  clear(): void { this.input.value = ""; this.echo.textContent = ""; }

  /** What was typed. Throws Refused, which the field shows. */
  async read(): Promise<CoordinateReply> {
    window.clearTimeout(this.timer);
    const text = this.input.value.trim();
    try {
      const reply = await api.coordinate(text);
      if (text === this.input.value.trim()) this.echo.textContent = `read as ${reply.texts["degrees"]}${reply.texts["mgrs"] ? `, ${reply.texts["mgrs"]}` : ""}`;
      return reply;
    } catch (error) {
      this.echo.textContent = text === "" ? "" : error instanceof Refused ? error.message : String(error);
      throw error;
    }
  }
}

/** The dialog for both; `done` gets the result as a text. */
export function wireAdding(state: State, done: (words: string) => void): void {
  const dialog = byId<HTMLDialogElement>("add-dialog"), form = byId<HTMLFormElement>("add-form"), result = byId("add-result");
  const field = new CoordinateField(form.elements.namedItem("place") as HTMLInputElement, byId("add-echo"));
  const value = (name: string): string => (form.elements.namedItem(name) as HTMLInputElement).value.trim();
  const failed = (error: unknown): void => { result.textContent = error instanceof Error ? error.message : String(error); };
  byId("add").addEventListener("click", () => { form.reset(); field.clear(); result.textContent = ""; dialog.showModal(); });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    result.textContent = "";
    const within = Number(value("within")), seen = value("seen");
    field.read().then((at) => api.typedPin({
      lat_deg: at.lat_deg, lon_deg: at.lon_deg, name: value("name"), category: state.options.category, who: state.options.who,
      ...(value("within") === "" ? {} : { sigma_m: within / Math.sqrt(-2 * Math.log(0.1)) }), ...(seen === "" ? {} : { seen_utc: `${seen}Z` }),
    })).then((reply) => {
      if (reply.pin === null) return;
      state.putPin(reply.pin, reply.revision);
      state.select(reply.pin.id);
      dialog.close();
      done(`pin ${reply.pin.number} added`);
    }).catch(failed);
  });
  byId<HTMLInputElement>("import-file").addEventListener("change", (event) => {
    const input = event.target as HTMLInputElement, file = input.files?.[0];
    if (file === undefined) return;
    result.textContent = `reading ${file.name} ...`;
    api.importFile(file, state.options.who).then((reply) => {
      dialog.close();
      const rest = [...(reply.known > 0 ? [`${reply.known} were here already`] : []), ...(reply.left_out > 0 ? [`${reply.left_out} things are no points`] : []), ...reply.bad.map((line) => `not read: ${line}`)];
      done(`${reply.imported} pins from ${file.name}${rest.length > 0 ? `; ${rest.join(", ")}` : ""}`);
    }, failed).finally(() => { input.value = ""; });
  });
}
