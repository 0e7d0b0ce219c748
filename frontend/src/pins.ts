// The list of pins, and the card of the one that is chosen. Rows have one height and lie where they belong: ten thousand
// cost no more than those in view, and nothing moves by itself when one is added.

import { api } from "./api.js";
import type { Coordinates } from "./coordinate.js";
import { copied } from "./copying.js";
import { byId, make, setText } from "./dom.js";
import { degrees, distance, heightText, methodWords, moment, radius, sentence, within, WITHIN_TITLE } from "./format.js";
import { FromMe } from "./from-me.js";
import { Menu } from "./menu.js";
import { KINDS, kindOf, shapeSvg } from "./shapes.js";
import { share } from "./sharing.js";
import type { State } from "./state.js";
import type { Category, Pin } from "./types.js";

const ROW_PX = 44;
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
  // Of the list, as last reported: asked for while drawing, the browser would have to lay the whole page out.
  private height = 0;
  private top = 0;
  private cardOf = "";
  private structureOf = ""; // of the card: what else than a place and its accuracy it shows

  private readonly fromMe = new FromMe();

  constructor(private readonly state: State, private readonly coordinates: Coordinates, private readonly actions: PinActions) {
    this.list.addEventListener("scroll", () => { this.top = this.list.scrollTop; this.draw(); }, { passive: true });
    this.filter.addEventListener("input", () => this.refresh());
    new ResizeObserver(() => { this.height = this.list.clientHeight; this.draw(); }).observe(this.list);
    for (const kind of KINDS) {
      const button = make("button", { type: "button", class: "chip", "aria-pressed": "true", title: `show ${kind.title.toLowerCase()}s`, "aria-label": `show ${kind.title.toLowerCase()}s` }, shapeSvg(kind, 18), kind.title);
      button.addEventListener("click", () => {
        const isHidden = this.hidden.has(kind.word);
        if (isHidden) this.hidden.delete(kind.word); else this.hidden.add(kind.word);
        button.setAttribute("aria-pressed", String(isHidden));
        this.refresh();
      });
      byId("filter-kinds").append(button);
    }
    new Menu(byId("kinds-shown"), byId("filter-kinds"));
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
    setText(byId("pin-count"), this.found.length === all ? String(all) : `${this.found.length} of ${all}`);
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
    title!.textContent = `${pin.name === "" ? kindOf(pin.category).title : pin.name}${formerly(pin)}`;
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

  /** Bring the chosen pin's row into view, however it was chosen, above the card that has opened. */
  private reveal(): void {
    const at = this.found.findIndex((pin) => pin.id === this.state.selected);
    if (at < 0) return;
    const height = this.list.clientHeight, top = at * ROW_PX;
    if (top < this.list.scrollTop || top + ROW_PX > this.list.scrollTop + height) this.list.scrollTop = Math.max(top - (height - ROW_PX) / 2, 0);
  }

  private showCard(): void {
    const pin = this.state.selected === null ? undefined : this.state.pins.get(this.state.selected);
    this.card.hidden = pin === undefined;
    if (pin === undefined || !this.cardOf.startsWith(pin.id)) this.fromMe.stop();
    if (pin === undefined) { this.cardOf = this.structureOf = ""; this.card.replaceChildren(); return; }
    const version = `${pin.id} ${pin.modified_utc} ${JSON.stringify(pin.place)}`;
    if (version === this.cardOf) return;
    const structure = JSON.stringify([pin.id, pin.name, pin.note, pin.category, pin.place.status, pin.clicks.map((click) => [click.id, click.who])]);
    if (structure === this.structureOf) { this.cardOf = version; this.measuredNow(pin); return; }
    // A user who types keeps the field; others' changes appear when the user leaves it.
    if (this.cardOf.startsWith(pin.id) && this.card.contains(document.activeElement) && document.activeElement instanceof HTMLInputElement) return;
    this.cardOf = version;
    this.structureOf = structure;
    this.card.replaceChildren(...this.content(pin));
  }

  /** Another place of the same clicks, as when the aircraft has measured one: in its place, and nothing else moves. */
  private measuredNow(pin: Pin): void {
    const held = this.card.querySelector(".facts"), wasOpen = held?.querySelector("details")?.open ?? false, facts = this.facts(pin);
    const how = facts.querySelector("details");
    if (how !== null) how.open = wasOpen;
    held?.replaceWith(facts);
  }

  private facts(pin: Pin): HTMLElement {
    const parts = pin.place.status === "ok" ? [make("div", { class: "sure-line" }, make("span", { title: WITHIN_TITLE }, factText(pin)), this.coordinates.choice()), howFound(pin), ...this.smaller(pin)] : [];
    return make("div", { class: "facts" }, make("div", { class: "place" }, pin.place.status === "ok" ? this.coordinates.element(pin.place) : placeText(pin)), ...parts, make("div", { class: "by" }, byText(pin)));
  }

  private content(pin: Pin): Node[] {
    const name = make("input", { type: "text", value: pin.name, maxlength: "200", placeholder: "name", "aria-label": "name" });
    name.addEventListener("change", () => this.actions.edit(pin, { name: name.value }));
    const note = make("textarea", { rows: "1", maxlength: "10000", placeholder: "note", "aria-label": "note" }, pin.note);
    note.addEventListener("change", () => this.actions.edit(pin, { note: note.value }));
    const category = make("select", { "aria-label": "category" }, ...KINDS.map((kind) =>
      make("option", { value: kind.word, selected: kind.word === pin.category }, kind.title)));
    category.addEventListener("change", () => this.actions.edit(pin, { category: category.value }));
    const crop = make("img", { class: "crop", alt: "the picture around the click", src: api.cropUrl(pin.id, String(pin.clicks.length)) });
    crop.addEventListener("error", () => crop.classList.add("none"));
    const button = (label: string, title: string, run: () => void, id?: string): HTMLButtonElement =>
      make("button", { type: "button", title, click: run, ...(id === undefined ? {} : { "data-testid": id }) }, label);
    const seen = make("div", { class: "seen" });
    const written = (): string => this.card.querySelector(".coordinate")?.textContent ?? placeText(pin);
    const copy = button("Copy", "the coordinate, as it is written here", () => void copied(written(), copy), "copy");
    const close = button("×", "close this card", () => this.state.select(null));
    close.setAttribute("aria-label", "close this card");
    const head = make("div", { class: "card-head" }, make("strong", {}, `Pin ${pin.number}${formerly(pin)}`), name, category, close);
    const last = pin.clicks.at(-1);
    const again = button("Click again", "click the same thing in another picture: the pin becomes surer", () => this.state.setMode({ kind: "again", pin: pin.id }));
    const remove = button("Delete", "delete; Undo brings it back", () => this.actions.remove(pin));
    // A pin without a place cannot be passed on, and no distance to it can be measured.
    const actions = make("div", { class: "buttons" }, ...(pin.place.status === "ok" ? [
      copy,
      button("Share", "by the phone's own sheet, or a geo: link and a QR code", () => void share(pin, written(), seen).catch((error: unknown) => { seen.textContent = String(error); }), "share"),
      button("From me", "distance and bearing from this device, true and magnetic", () => { if (pin.place.status === "ok") this.fromMe.toggle(pin.place, seen); }, "from-me-button"),
      button("Hand off", "coordinate in every format, QR code, print (H)", () => this.actions.handoff(pin), "handoff"),
      again,
      button("Seen in", "the pictures that show it", () => void this.listSeen(pin, seen)),
      button("Measure", "distance and bearing to another pin", () => this.listMeasure(pin, seen)),
    ] : [
      again, ...(last === undefined ? [] : [button("Remove last click", "the pin is then where its other clicks put it", () => this.actions.removeClick(pin, last.id), "remove-last")]),
    ]), remove);
    return [head, make("div", { class: "card-body" }, crop, make("div", { class: "card-words" }, this.facts(pin), note)), actions, seen, ...this.clicks(pin)];
  }

  /** What a radius is mostly from, and what would make it smaller: of a flight that still runs, or of a recording's end. */
  private smaller(pin: Pin): Node[] {
    const last = pin.clicks.at(-1), flies = this.state.vehicles.find((v) => v.id === last?.vehicle && v.session === last.session);
    if (flies === undefined || flies.radius === "") return [];
    return [make("div", { class: "smaller", "data-testid": "smaller", title: "where the radius comes from at the newest picture, and what would make it smaller" }, sentence(flies.radius))];
  }

  private clicks(pin: Pin): Node[] {
    if (pin.clicks.length < 2) return [];
    return [make("ul", { class: "clicks" }, ...pin.clicks.map((click) => make("li", {},
      `${click.frame === null ? "typed" : `picture ${click.frame}`}${click.who === "" ? "" : ` by ${click.who}`}`,
      make("button", { type: "button", "aria-label": `remove this click`, click: () => this.actions.removeClick(pin, click.id) }, "Remove"))))];
  }

  private async listSeen(pin: Pin, into: HTMLElement): Promise<void> {
    this.fromMe.stop();
    into.textContent = "looking through the pictures ...";
    into.scrollIntoView({ block: "nearest" });
    const seen = await api.seen(pin.id);
    const none = pin.place.status === "ok" ? "no picture shows it" : "where it is is not known: nothing to look for";
    into.replaceChildren(seen.length === 0 ? none : `${seen.length === 1 ? "1 picture shows" : `${seen.length} pictures show`} it:`);
    const step = Math.max(1, Math.ceil(seen.length / 40));
    for (let k = 0; k < seen.length; k += step) {
      const { vehicle, frame, u_px, v_px } = seen[k]!;
      into.append(make("button", { type: "button", class: "frame", click: () => this.actions.open(vehicle, frame, u_px, v_px) }, String(frame)));
    }
    into.scrollIntoView({ block: "nearest" });
  }

  private listMeasure(pin: Pin, into: HTMLElement): void {
    this.fromMe.stop();
    const others = [...this.state.pins.values()].filter((other) => other.id !== pin.id).sort((a, b) => a.number - b.number);
    if (others.length === 0) { into.textContent = "there is no other pin"; return; }
    const choice = make("select", { "aria-label": "measure to" }, make("option", { value: "" }, "to which pin?"),
      ...others.slice(0, 1000).map((other) => make("option", { value: other.id }, `${other.number} ${other.name}`)));
    const result = make("output", {});
    choice.addEventListener("change", () => {
      if (choice.value === "") return;
      api.measure(pin.id, choice.value).then((reply) => { result.textContent = measureText(reply); }, (error: unknown) => { result.textContent = String(error); });
    });
    into.replaceChildren(choice, " ", result);
    into.scrollIntoView({ block: "nearest" });
    choice.focus({ preventScroll: true });
  }
}

/** Other numbers that a pin had, by which somebody may have named it on the radio; empty for most. */
function formerly(pin: Pin): string { return pin.was.length === 0 ? "" : ` (was ${pin.was.join(", ")})`; }

function measureText(reply: Record<string, number | string | null>): string {
  const number = (key: string): number | null => (typeof reply[key] === "number" ? reply[key] : null);
  const metres = number("distance_m"), bearing = number("bearing_deg");
  if (reply["status"] !== "ok" || metres === null || bearing === null) return String(reply["reason"] ?? "not known");
  const rise = number("height_difference_m");
  const sigma = (key: string, unit: string): string => (number(key) === null ? "" : ` ± ${number(key)!.toFixed(1)}${unit}`);
  return `${distance(metres)}${sigma("sigma_distance_m", " m")}, bearing ${bearing.toFixed(1).padStart(5, "0")}°${sigma("sigma_bearing_deg", "°")}` +
    (rise === null ? "" : `, ${rise >= 0 ? "up" : "down"} ${Math.abs(rise).toFixed(1)} m${sigma("sigma_height_difference_m", " m")}`) + " (1σ)";
}

export function placeText(pin: Pin): string {
  return pin.place.status === "ok" ? degrees(pin.place.lat_deg, pin.place.lon_deg, pin.place.ce90_m) : pin.place.reason;
}

export function sureText(pin: Pin): string {
  if (pin.place.status === "ok") return pin.place.ce90_m === null ? "accuracy unknown" : radius(pin.place.ce90_m);
  return pin.place.status === "contradiction" ? "contradicts itself" : "no place";
}

function factText(pin: Pin): string {
  const place = pin.place;
  if (place.status !== "ok") return "";
  return `${within(place.ce90_m)}, ${heightText(place)}${place.le90_m === null ? "" : `, 90 % within ${radius(place.le90_m)}`}`;
}

/** How its last click was answered; what that means, and why it was not measured, when it is asked for. */
function howFound(pin: Pin): HTMLElement {
  const [words, meaning] = methodWords(pin.clicks.at(-1));
  return make("details", { class: "how", "data-testid": "how" }, make("summary", { title: meaning }, words), meaning);
}

/** Of how many clicks it is, when it was seen, and who marked it: the click itself may be much later. */
function byText(pin: Pin): string {
  const seen = pin.seen_utc === null ? "time of sighting unknown" : `seen ${moment(pin.seen_utc)}`;
  const place = pin.place.status === "ok" ? pin.place : { clicks: pin.clicks.length, tied: 0 };
  const clicks = `${place.clicks} click${place.clicks === 1 ? "" : "s"}${place.tied > 0 ? `, ${place.tied} known place${place.tied === 1 ? "" : "s"}` : ""}`;
  return `${clicks}, ${seen}${pin.who === "" ? "" : `, marked by ${pin.who}`}`;
}
