// What a click in the picture does: a pin, one more click on a pin, or a known place; and the message about it.

import { api, Refused } from "./api.js";
import { showTie } from "./dialogs.js";
import type { Coordinates, Where } from "./coordinate.js";
import { byId, make } from "./dom.js";
import { age, degrees, heightText, methodWords, within, WITHIN_TITLE } from "./format.js";
import type { Following } from "./following.js";
import type { Looking } from "./looking.js";
import type { PicturePane } from "./picture.js";
import { kindOf } from "./shapes.js";
import type { State } from "./state.js";
import type { ClickAnswer, ClickBody, Pin, PinReply, PlaceReply } from "./types.js";

export class Clicking {
  private readonly answer = byId("answer");
  private count = 0;
  private pendingNew = 0;
  private answered: { pin: string; click: string; ageS: number | null; shown: string } | null = null; // of the answer that is shown
  private looked = 0;

  following: Following | null = null; // is offered what was clicked
  looking: Looking | null = null; // is offered what was answered

  constructor(private readonly state: State, private readonly coordinates: Coordinates) {
    state.on(["pins"], () => this.showAgain());
  }

  show(text: string, kind: "ok" | "refused" | "note" = "note"): void {
    this.answered = null;
    this.answer.dataset["kind"] = kind;
    this.answer.title = "";
    this.answer.textContent = text;
  }

  async clicked(body: ClickBody, picture: PicturePane): Promise<void> {
    const { state } = this, mode = state.mode;
    state.setMode({ kind: "pin" });
    if (!state.mayChange) { await this.look(body); return; }
    if (mode.kind === "tie") {
      showTie(body, state, (tie) => this.show(`known place ${tie.name === "" ? degrees(tie.lat_deg, tie.lon_deg, tie.sigma_m) : tie.name}: all pins of ${tie.vehicle} in this flight moved`));
      return;
    }
    const again = mode.kind === "again" ? state.pins.get(mode.pin) : undefined;
    await this.make(body, picture, again, false);
  }

  /** Who may change nothing is shown the place. */
  private async look(body: ClickBody): Promise<void> {
    const look = ++this.looked;
    this.show("...");
    try {
      const reply = await api.place(body);
      this.showPlace(reply);
      if (reply.status !== "ok" || this.state.server?.measures !== true) return;
      const measured = await api.place({ ...body, measured: true });
      if (look === this.looked) this.showPlace(measured);
    } catch (error) {
      this.show(error instanceof Refused ? error.message : String(error), "refused");
    }
  }

  private showPlace(reply: PlaceReply): void {
    if (reply.status !== "ok") { this.show(`Refused: ${reply.reason ?? reply.status}`, "refused"); return; }
    const [words, meaning] = methodWords(reply);
    this.show("", "ok");
    this.answer.append(this.words(reply, `${heightText(reply)}  ${words}`));
    this.answer.title = `${WITHIN_TITLE}; ${meaning}`;
  }

  private async make(body: ClickBody, picture: PicturePane, again: Pin | undefined, anyway: boolean): Promise<void> {
    const { state } = this, key = `click ${++this.count}`, who = state.options.who;
    state.clicksUnderWay += 1;
    const category = again?.category ?? state.options.category, number = again?.number ?? state.nextNumber() + this.pendingNew;
    if (again === undefined) this.pendingNew += 1;
    picture.markers.clearRefusals();
    this.show(`${kindOf(category).title} ${number}: ...`);
    picture.markers.begin({ key, number, category, vehicle: body.vehicle, session: body.session, frame: body.frame, at: body, text: "", isRefused: false });
    try {
      const reply: PinReply = again === undefined ? await api.addPin({ click: body, category, who }) : await api.addClick(again.id, { ...body, who, anyway });
      if (reply.pin !== null) {
        picture.markers.done(key);
        state.putPin(reply.pin, reply.revision);
        this.showPin(reply.pin, reply.answer);
        this.following?.clicked(body);
        this.looking?.clicked(body);
      } else if (reply.apart_m !== undefined && again !== undefined) {
        picture.markers.refuse(key, reply.reason ?? "");
        this.offer(reply.apart_m, body, picture, again);
      } else {
        const refusal = reply.answer;
        const text = `${refusal?.reason ?? refusal?.status ?? "no answer"}.${refusal?.advice ? ` What helps: ${refusal.advice}.` : ""}`;
        this.show(`Refused: ${text}`, "refused");
        this.following?.clicked(body);
        picture.markers.refuse(key, text);
      }
    } catch (error) {
      const text = error instanceof Refused ? error.message : String(error);
      this.show(`Not kept: ${text}`, "refused");
      picture.markers.refuse(key, text);
    } finally {
      state.clicksUnderWay -= 1;
      if (again === undefined) this.pendingNew -= 1;
    }
  }

  private showPin(pin: Pin, reply: ClickAnswer | null): void {
    this.answer.replaceChildren(make("div", { class: "answer-words" }));
    this.answer.dataset["kind"] = "ok";
    this.answered = { pin: pin.id, click: pin.clicks.at(-1)?.id ?? "", ageS: reply?.age_s ?? null, shown: "" };
    this.showAgain();
  }

  /** The same answer by what is known of its pin now: the aircraft may have measured the click since. */
  private showAgain(): void {
    const answered = this.answered, pin = answered === null ? undefined : this.state.pins.get(answered.pin);
    const click = pin?.clicks.find((one) => one.id === answered?.click), line = this.answer.querySelector(".answer-words");
    if (answered === null || pin === undefined || click === undefined || line === null) return;
    const isOpen = this.state.server?.measures === true && click.method !== "measured" && click.unmeasured === "";
    const [words, meaning] = methodWords(click);
    const how = `${words}${isOpen ? ", being measured ..." : ""}, picture ${answered.ageS === null ? "of unknown age" : `${age(answered.ageS)} old`}`;
    const name = `${kindOf(pin.category).title} ${pin.number}`, place = pin.place;
    if (place.status !== "ok") { line.textContent = `${name}: ${place.reason}`; return; }
    const key = JSON.stringify([place, how]);
    if (answered.shown === key) return;
    answered.shown = key;
    line.replaceWith(this.words(place, `${name}: ${heightText(place)}  ${how}`));
    this.answer.title = `${WITHIN_TITLE}; ${meaning}`;
  }

  /** The coordinate and its radius large, the rest below. */
  private words(where: Where, rest: string): HTMLElement {
    return make("div", { class: "answer-words" }, make("div", { class: "answer-place" }, this.coordinates.element(where), make("span", { class: "sure" }, `  ${within(where.ce90_m)}`)), make("div", { class: "rest" }, rest));
  }

  /** A click that contradicts its pin was not added: the pin is where it was, and the operator decides on the click. */
  private offer(apart: number, body: ClickBody, picture: PicturePane, again: Pin): void {
    this.show(`Not added: ${apart.toFixed(0)} m from pin ${again.number}.`, "refused");
    const button = (label: string, run: () => void): HTMLButtonElement => make("button", { type: "button", click: run }, label);
    this.answer.append(
      button("Make it a new pin", () => void this.make(body, picture, undefined, false)),
      button("Add it anyway", () => void this.make(body, picture, again, true)),
      button("Remove last click", () => { picture.markers.clearRefusals(); this.show(`pin ${again.number} is as it was`); }));
  }
}
