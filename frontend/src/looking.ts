// Having an aircraft's camera look at what was clicked, and the aircraft circle about it: each time its own place and
// height are confirmed before anything moves.

import { api, Refused } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { degrees, within } from "./format.js";
import type { State } from "./state.js";
import type { ClickBody, LookOffer } from "./types.js";

type Show = (text: string, kind: "ok" | "refused" | "note") => void;

export class Looking {
  private readonly dialog = byId<HTMLDialogElement>("look-dialog");
  private readonly go = byId<HTMLButtonElement>("look-go");
  private offer: { of: LookOffer; at: number; body: ClickBody } | null = null; // and when it came, by performance.now()
  private isAsking = false;

  constructor(private readonly state: State, private readonly show: Show) {
    this.go.addEventListener("click", () => void this.confirm());
    this.dialog.addEventListener("close", () => {
      const offer = this.offer;
      if (offer === null) return;
      this.offer = null;
      this.show(offer.of.circle === null ? "Not confirmed: nothing was sent." : `Not confirmed: no circle was sent; the camera of ${offer.of.vehicle} still looks there.`, "note");
      this.clicked(offer.body);
    });
  }

  /** Whether this browser may turn that aircraft's camera. */
  may(vehicle: string): boolean {
    return this.state.server?.role === "pointer" && this.state.vehicles.find((one) => one.id === vehicle)?.unlooked === "";
  }

  /** A click was answered with a place: the camera may be sent there. */
  clicked(body: ClickBody): void {
    if (!this.may(body.vehicle)) return;
    byId("answer").append(make("button", { type: "button", class: "look-there", "data-testid": "look-there", title: `have the camera of ${body.vehicle} look there`, click: () => void this.ask(body) }, "Look there"));
  }

  /** The camera looks where it did before. */
  async ahead(vehicle: string): Promise<void> {
    await this.asking(`Asking ${vehicle} to look ahead ...`, null, async () => {
      await api.lookAhead(vehicle);
      this.show(`Accepted by the autopilot: the camera of ${vehicle} looks ahead again; the aircraft flies on as it does.`, "ok");
    });
  }

  private async ask(body: ClickBody): Promise<void> {
    await this.asking(`Asking ${body.vehicle} for the place ...`, body, async () => this.propose(await api.look(body), body));
  }

  /** What the camera looks at the aircraft may circle about. */
  private offerCircle({ vehicle, ticket }: LookOffer, body: ClickBody): void {
    const ask = (): Promise<void> => this.asking(`Asking ${vehicle} for the circle ...`, body, async () => this.propose(await api.lookCircle({ vehicle, ticket }), body));
    byId("answer").append(make("button", { type: "button", class: "look-there", "data-testid": "circle-there", title: `have ${vehicle} circle about it`, click: () => void ask() }, "Circle there"));
  }

  /** What would be done is shown, to be confirmed. */
  private propose(offer: LookOffer, body: ClickBody): void {
    const { circle, height_amsl_m, ce90_m, vehicle } = offer;
    this.offer = { of: offer, at: performance.now(), body };
    setText(byId("look-title"), circle === null ? `Have the camera of ${vehicle} look there?` : `Have ${vehicle} circle there?`);
    setText(byId("look-place"), placeOf(offer));
    setText(byId("look-height"), circle === null
      ? `${height_amsl_m.toFixed(0)} m above sea level, ${within(ce90_m)}`
      : `at ${circle.height_amsl_m.toFixed(0)} m above sea level, ${circle.above_place_m.toFixed(0)} m above the place; radius ${circle.radius_m.toFixed(0)} m`);
    setText(byId("look-note"), circle === null
      ? "It keeps looking there until it is sent elsewhere. Where no gimbal can, the autopilot may turn the aircraft itself."
      : "The aircraft leaves its mission, until the pilot or a ground station sends it elsewhere. Hills, masts and other aircraft round the circle are not known here.");
    setText(this.go, circle === null ? "Turn the camera" : "Fly the circle");
    this.dialog.showModal();
  }

  private async confirm(): Promise<void> {
    const offer = this.offer;
    if (offer === null) return;
    this.offer = null;
    this.dialog.close();
    const { vehicle, ticket, height_amsl_m, circle } = offer.of;
    await this.asking("Asking the autopilot ...", offer.body, async () => {
      const done = await api.lookConfirm({ vehicle, ticket, waited_s: (performance.now() - offer.at) / 1000 });
      const what = circle === null
        ? `the camera of ${vehicle} looks at ${placeOf(offer.of)}, ${height_amsl_m.toFixed(0)} m`
        : `${vehicle} circles about ${placeOf(offer.of)} at ${circle.height_amsl_m.toFixed(0)} m`;
      this.show(`Accepted by the autopilot: ${what}.`, "ok");
      if (done.may_circle === true) this.offerCircle(offer.of, offer.body);
    });
  }

  /** One question at a time; what fails may be tried again. */
  private async asking(words: string, body: ClickBody | null, what: () => Promise<void>): Promise<void> {
    if (this.isAsking) return;
    this.isAsking = true;
    this.show(words, "note");
    try {
      await what();
    } catch (error) {
      this.show(`Not done: ${error instanceof Refused ? error.message : String(error)}`, "refused");
      if (body !== null) this.clicked(body);
    } finally {
      this.isAsking = false;
    }
  }
}

function placeOf(offer: LookOffer): string { return degrees(offer.lat_deg, offer.lon_deg, offer.ce90_m); }
