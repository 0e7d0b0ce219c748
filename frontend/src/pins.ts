// The list of pins, and the card of the one that is chosen. Rows have one height and lie where they belong: ten thousand
// cost no more than those in sight, and nothing moves by itself when one is added.

import { api } from "./api.js";
import { byId, make, say } from "./dom.js";
import { degrees, distance, radius } from "./format.js";
import { KINDS, kindOf, shapeSvg } from "./shapes.js";
import type { State } from "./state.js";
import type { Category, Pin } from "./types.js";

const ROW_PX = 56;
const SPARE = 4;

export interface PinActions {
  handoff(pin: Pin): void;
  open(vehicle: string, frame: number, u: number, v: number): void;
  remove(pin: Pin): void;
  edit(pin: Pin, changed: { name?: string; note?: string; category?: string }): void;
  goTo(pin: Pin): void;
  removeClick(pin: Pin, click: string): void;
}

export class PinList {
  private readonly list = byId("pin-list");
  private readonly body = byId("pin-rows");
  private readonly filter = byId<HTMLInputElement>("filter");
  private readonly card = byId("pin-card");
  private readonly rows = new Map<string, HTMLElement>();
  private readonly hidden = new Set<Category>();
  private found: readonly Pin[] = [];
  private isDue = false;
  // Of the list, as it said last: asked for while drawing, the browser would have to lay the whole page out.
  private height = 0;
  private top = 0;
  private cardOf = "";

  constructor(private readonly state: State, private readonly actions: PinActions) {
    this.list.addEventListener("scroll", () => { this.top = this.list.scrollTop; this.draw(); }, { passive: true });
    this.filter.addEventListener("input", () => this.refresh());
    new ResizeObserver(() => { this.height = this.list.clientHeight; this.draw(); }).observe(this.list);
    for (const kind of KINDS) {
      const button = make("button", { type: "button", class: "chip", "aria-pressed": "true", title: `show ${kind.title.toLowerCase()}s`, "aria-label": `show ${kind.title.toLowerCase()}s` }, shapeSvg(kind, 18));
      button.addEventListener("click", () => {
        const isHidden = this.hidden.has(kind.word);
        if (isHidden) this.hidden.delete(kind.word); else this.hidden.add(kind.word);
        button.setAttribute("aria-pressed", String(isHidden));
        this.refresh();
      });
      byId("filter-kinds").append(button);
    }
    state.on(["pins"], () => this.later());
    state.on(["hover", "selected"], () => this.mark());
    state.on(["selected"], () => { this.showCard(); this.reveal(); });
    this.refresh();
  }

  /** With the next frame of the screen, however many pins have changed. */
  private later(): void {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => { this.isDue = false; this.refresh(); });
  }

  private refresh(): void {
    const wanted = this.filter.value.trim().toLowerCase();
    const newest = this.state.newestFirst();
    this.found = wanted === "" && this.hidden.size === 0 ? newest : newest
      .filter((pin) => !this.hidden.has(pin.category))
      .filter((pin) => wanted === "" || `${pin.number} ${pin.name} ${pin.note} ${pin.who} ${kindOf(pin.category).title}`.toLowerCase().includes(wanted));
    const all = newest.length;
    say(byId("pin-count"), this.found.length === all ? String(all) : `${this.found.length} of ${all}`);
    byId("no-pins").hidden = all > 0;
    this.draw();
    this.showCard();
  }

  private draw(): void {
    this.body.style.height = `${this.found.length * ROW_PX}px`;
    const first = Math.max(Math.floor(this.top / ROW_PX) - SPARE, 0);
    const last = Math.min(Math.ceil((this.top + this.height) / ROW_PX) + SPARE, this.found.length);
    const seen = new Set<string>();
    for (let k = first; k < last; k++) {
      const pin = this.found[k]!;
      seen.add(pin.id);
      let row = this.rows.get(pin.id);
      if (row === undefined) {
        row = this.row(pin);
        this.rows.set(pin.id, row);
        this.body.append(row);
      }
      this.fill(row, pin);
      row.style.transform = `translateY(${k * ROW_PX}px)`;
      row.setAttribute("aria-posinset", String(k + 1));
      row.setAttribute("aria-setsize", String(this.found.length));
    }
    for (const [id, row] of this.rows) if (!seen.has(id)) { row.remove(); this.rows.delete(id); }
    this.mark();
  }

  private row(pin: Pin): HTMLElement {
    const row = make("div", { class: "row", role: "option", tabindex: "0", "data-testid": "pin", "data-id": pin.id });
    row.append(make("span", { class: "shape" }), make("span", { class: "title" }), make("span", { class: "where" }), make("span", { class: "sure" }));
    row.addEventListener("pointerenter", () => this.state.hover(pin.id));
    row.addEventListener("pointerleave", () => this.state.hover(null));
    row.addEventListener("focus", () => this.state.hover(pin.id));
    const choose = (): void => this.state.select(this.state.selected === pin.id ? null : pin.id);
    row.addEventListener("click", choose);
    row.addEventListener("dblclick", () => this.actions.goTo(this.state.pins.get(pin.id) ?? pin));
    row.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); event.stopPropagation(); choose(); }
    });
    return row;
  }

  private fill(row: HTMLElement, pin: Pin): void {
    const look = `${pin.modified_utc} ${JSON.stringify(pin.place)}`;
    if (row.dataset["look"] === look) return;
    row.dataset["look"] = look;
    row.dataset["number"] = String(pin.number);
    const [shape, title, where, sure] = [...row.children] as HTMLElement[];
    shape!.replaceChildren(shapeSvg(kindOf(pin.category), 30, String(pin.number)));
    title!.textContent = pin.name === "" ? kindOf(pin.category).title : pin.name;
    where!.textContent = placeText(pin);
    sure!.textContent = sureText(pin);
    sure!.classList.toggle("bad", pin.place.status !== "ok");
  }

  private mark(): void {
    for (const [id, row] of this.rows) {
      row.classList.toggle("hovered", id === this.state.hovered);
      row.classList.toggle("selected", id === this.state.selected);
      row.setAttribute("aria-selected", String(id === this.state.selected));
    }
  }

  /** The chosen pin's row in sight, however it was chosen, above the card that has opened. */
  private reveal(): void {
    const at = this.found.findIndex((pin) => pin.id === this.state.selected);
    if (at < 0) return;
    const height = this.list.clientHeight, top = at * ROW_PX;
    if (top < this.list.scrollTop || top + ROW_PX > this.list.scrollTop + height) this.list.scrollTop = Math.max(top - (height - ROW_PX) / 2, 0);
  }

  private showCard(): void {
    const pin = this.state.selected === null ? undefined : this.state.pins.get(this.state.selected);
    this.card.hidden = pin === undefined;
    if (pin === undefined) { this.cardOf = ""; this.card.replaceChildren(); return; }
    const version = `${pin.id} ${pin.modified_utc} ${JSON.stringify(pin.place)}`;
    if (version === this.cardOf) return;
    // Somebody who types keeps the field; what others changed is there once it is left.
    if (this.cardOf.startsWith(pin.id) && this.card.contains(document.activeElement) && document.activeElement instanceof HTMLInputElement) return;
    this.cardOf = version;
    this.card.replaceChildren(...this.content(pin));
  }

  private content(pin: Pin): Node[] {
    const name = make("input", { type: "text", value: pin.name, maxlength: "200", placeholder: "name", "aria-label": "name" });
    name.addEventListener("change", () => this.actions.edit(pin, { name: name.value }));
    const note = make("textarea", { rows: "2", maxlength: "10000", placeholder: "note", "aria-label": "note" }, pin.note);
    note.addEventListener("change", () => this.actions.edit(pin, { note: note.value }));
    const category = make("select", { "aria-label": "category" }, ...KINDS.map((kind) =>
      make("option", { value: kind.word, selected: kind.word === pin.category }, kind.title)));
    category.addEventListener("change", () => this.actions.edit(pin, { category: category.value }));
    const crop = make("img", { class: "crop", alt: "the picture around the click", src: api.cropUrl(pin.id, String(pin.clicks.length)) });
    crop.addEventListener("error", () => crop.classList.add("none"));
    const button = (label: string, title: string, run: () => void, id?: string): HTMLButtonElement =>
      make("button", { type: "button", title, click: run, ...(id === undefined ? {} : { "data-testid": id }) }, label);
    const seen = make("div", { class: "seen" });
    const head = make("div", { class: "card-head" },
      make("strong", {}, `Pin ${pin.number}`), name, category,
      button("Close", "close this card", () => this.state.select(null)));
    const actions = make("div", { class: "buttons" },
      button("Hand off", "coordinate in every format, QR code, print (H)", () => this.actions.handoff(pin), "handoff"),
      button("Click again", "click the same thing in another picture: the pin becomes surer", () => this.state.setMode({ kind: "again", pin: pin.id })),
      button("Seen in", "the pictures that show it", () => void this.listSeen(pin, seen)),
      button("Measure", "distance and bearing to another pin", () => this.listMeasure(pin, seen)),
      button("Delete", "delete; Undo brings it back", () => this.actions.remove(pin)));
    const facts = make("div", { class: "facts" }, make("div", {}, placeText(pin)), make("div", {}, factText(pin)), make("div", { class: "by" }, byText(pin)));
    return [head, make("div", { class: "card-body" }, crop, note), facts, actions, seen, ...this.clicks(pin)];
  }

  private clicks(pin: Pin): Node[] {
    if (pin.clicks.length < 2) return [];
    return [make("ul", { class: "clicks" }, ...pin.clicks.map((click) => make("li", {},
      `${click.frame === null ? "entered" : `picture ${click.frame}`}${click.who === "" ? "" : ` by ${click.who}`}`,
      make("button", { type: "button", "aria-label": `remove this click`, click: () => this.actions.removeClick(pin, click.id) }, "Remove"))))];
  }

  private async listSeen(pin: Pin, into: HTMLElement): Promise<void> {
    into.textContent = "looking through the pictures ...";
    const seen = await api.seen(pin.id);
    into.replaceChildren(seen.length === 0 ? "no picture shows it" : `${seen.length} pictures show it:`);
    const step = Math.max(1, Math.ceil(seen.length / 40));
    for (let k = 0; k < seen.length; k += step) {
      const { vehicle, frame, u_px, v_px } = seen[k]!;
      into.append(make("button", { type: "button", class: "frame", click: () => this.actions.open(vehicle, frame, u_px, v_px) }, String(frame)));
    }
  }

  private listMeasure(pin: Pin, into: HTMLElement): void {
    const others = [...this.state.pins.values()].filter((other) => other.id !== pin.id).sort((a, b) => a.number - b.number);
    if (others.length === 0) { into.textContent = "there is no other pin"; return; }
    const choice = make("select", { "aria-label": "measure to" }, make("option", { value: "" }, "to which pin?"),
      ...others.slice(0, 1000).map((other) => make("option", { value: other.id }, `${other.number} ${other.name}`)));
    const result = make("output", {});
    choice.addEventListener("change", () => {
      if (choice.value === "") return;
      api.measure(pin.id, choice.value).then((said) => { result.textContent = measureText(said); }, (error: unknown) => { result.textContent = String(error); });
    });
    into.replaceChildren(choice, " ", result);
  }
}

function measureText(said: Record<string, number | string | null>): string {
  const number = (key: string): number | null => (typeof said[key] === "number" ? said[key] : null);
  const metres = number("distance_m"), bearing = number("bearing_deg");
  if (said["status"] !== "ok" || metres === null || bearing === null) return String(said["reason"] ?? "not known");
  const rise = number("height_difference_m");
  const sigma = (key: string, unit: string): string => (number(key) === null ? "" : ` ± ${number(key)!.toFixed(1)}${unit}`);
  return `${distance(metres)}${sigma("sigma_distance_m", " m")}, bearing ${bearing.toFixed(1).padStart(5, "0")}°${sigma("sigma_bearing_deg", "°")}` +
    (rise === null ? "" : `, ${rise >= 0 ? "up" : "down"} ${Math.abs(rise).toFixed(1)} m${sigma("sigma_height_difference_m", " m")}`) + " (1σ)";
}

export function placeText(pin: Pin): string {
  return pin.place.status === "ok" ? degrees(pin.place.lat_deg, pin.place.lon_deg) : pin.place.reason;
}

export function sureText(pin: Pin): string {
  if (pin.place.status === "ok") return pin.place.ce90_m === null ? "accuracy unknown" : `±${radius(pin.place.ce90_m)}`;
  return pin.place.status === "contradiction" ? "contradicts itself" : "no place";
}

function factText(pin: Pin): string {
  const place = pin.place;
  if (place.status !== "ok") return "";
  const height = place.height_amsl_m !== null ? `${place.height_amsl_m.toFixed(1)} m AMSL`
    : place.height_ellipsoid_m !== null ? `${place.height_ellipsoid_m.toFixed(1)} m above the ellipsoid` : "height unknown";
  const sure = place.ce90_m === null ? "accuracy unknown" : `±${radius(place.ce90_m)} (CE90)`;
  return `${sure}, ${height}${place.le90_m === null ? "" : ` ±${radius(place.le90_m)}`}, ${place.clicks} click${place.clicks === 1 ? "" : "s"}${place.tied > 0 ? `, ${place.tied} tie${place.tied === 1 ? "" : "s"}` : ""}`;
}

function byText(pin: Pin): string {
  return `${pin.who === "" ? "" : `${pin.who}, `}${pin.created_utc.slice(0, 19).replace("T", " ")} UTC`;
}
