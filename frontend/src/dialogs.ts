// The hand-off card, the tie and the help.

import { api, Refused } from "./api.js";
import { copied } from "./copying.js";
import { byId, make } from "./dom.js";
import { CoordinateField } from "./adding.js";
import { degrees, moment, within } from "./format.js";
import type { MapPane } from "./map.js";
import { kindOf, shapeSvg } from "./shapes.js";
import type { State } from "./state.js";
import type { ClickBody, Pin, Tie } from "./types.js";

export async function showHandoff(pin: Pin, state: State, map: MapPane | null): Promise<void> {
  const dialog = byId<HTMLDialogElement>("handoff-dialog"), body = byId("handoff-body");
  const from = make("select", { "aria-label": "bearing and distance from" }, make("option", { value: "" }, "from nowhere"),
    ...[...state.pins.values()].filter((other) => other.id !== pin.id && other.place.status === "ok")
      .sort((a, b) => a.number - b.number).slice(0, 1000).map((other) => make("option", { value: other.id }, `from pin ${other.number} ${other.name}`)));
  const crs = make("input", { type: "text", maxlength: "40", placeholder: "EPSG:2193", "aria-label": "another coordinate system" });
  const table = make("div", { class: "formats" }), readback = make("p", { id: "readback", class: "readback" });
  const print = byId<HTMLButtonElement>("print");
  let asked = 0;
  const fill = async (): Promise<void> => {
    const mine = ++asked;
    const reply = await api.handoff(pin.id, from.value, crs.value.trim());
    if (mine !== asked) return; // a later choice has been asked for
    table.replaceChildren(...reply.texts.map(({ name, title, text }) => {
      const button: HTMLButtonElement = make("button", { type: "button", click: () => void copied(text, button), "aria-label": `copy ${title}` }, "Copy");
      return make("div", { class: "format", "data-format": name }, make("span", { class: "format-name" }, title), make("span", { class: "format-text" }, text), button);
    }));
    readback.textContent = reply.readback;
  };
  const crop = make("img", { class: "crop", alt: "the picture around the click", src: api.cropUrl(pin.id, String(pin.clicks.length)) });
  crop.addEventListener("error", () => crop.remove());
  const head = make("div", { class: "handoff-head" }, shapeSvg(kindOf(pin.category), 44, String(pin.number)),
    make("div", {}, make("h2", {}, pin.name === "" ? `${kindOf(pin.category).title} ${pin.number}` : pin.name), make("p", {}, pin.note),
      make("p", { class: "only-print" }, `printed ${moment(new Date().toISOString())} by ${state.options.who === "" ? "no name given" : state.options.who}; pointclick, ${state.server?.source ?? ""}`)));
  const pictures = make("div", { class: "handoff-pictures" }, crop,
    make("figure", {}, make("img", { class: "qr", alt: "QR code of the position, for a phone's camera", src: `${api.qrUrl(pin.id)}?v=${encodeURIComponent(pin.modified_utc)}` }), make("figcaption", {}, "position for a phone")));
  const onMap = mapOf(pin, map);
  body.replaceChildren(head, make("div", { class: "handoff-columns" }, table, pictures),
    make("div", { class: "from no-print" }, make("label", {}, "Bearing and distance ", from), make("label", {}, " Other system ", crs)),
    make("div", { class: "buttons no-print" }, make("a", { class: "as-button", href: api.packageUrl(pin.id), download: "", "data-testid": "package" }, "TAK data package"), ...sending(pin, state)),
    make("h3", {}, "On the radio"), readback, onMap.figure);
  for (const field of [from, crs]) field.addEventListener("change", () => void fill());
  print.disabled = true; // half a card is not printed
  dialog.showModal();
  try {
    await fill();
  } catch (error) {
    table.textContent = error instanceof Refused ? error.message : String(error);
  }
  await onMap.settled;
  if (table.isConnected) print.disabled = false; // otherwise another pin's card is open
}

/** The button that sends a pin to the TAK server, where there is one and this browser may; and what came of it. */
function sending(pin: Pin, state: State): Node[] {
  const tak = state.server?.tak ?? "";
  if (tak === "" || !state.mayChange) return [];
  const result = make("output", { "data-testid": "tak-result" });
  const button = make("button", { type: "button", "data-testid": "tak-send", title: `to ${tak}`, click: () => {
    button.disabled = true;
    result.textContent = "sending ...";
    api.sendToTak(pin.id)
      .then(({ sent }) => { result.textContent = `sent to ${sent}, ${moment(new Date().toISOString())}`; }, (error: unknown) => { result.textContent = `not sent: ${error instanceof Error ? error.message : String(error)}`; })
      .finally(() => { button.disabled = false; });
  } }, "Send to TAK");
  return [button, result];
}

let tieField: CoordinateField | null = null;

/** The map about a pin, north up, with what the operator sees on it, and when it is there; nothing where there is no map. */
function mapOf(pin: Pin, map: MapPane | null): { figure: HTMLElement; settled: Promise<void> } {
  const figure = make("figure", { class: "handoff-map", hidden: true });
  if (map === null || pin.place.status !== "ok") return { figure, settled: Promise.resolve() };
  const { lat_deg, lon_deg, ce90_m } = pin.place;
  const settled = map.snapshot(lat_deg, lon_deg, Math.max(6 * (ce90_m ?? 20), 60)).then((image) => {
    if (image === null) return;
    figure.append(make("img", { src: image, alt: `map about pin ${pin.number}, north up` }), make("figcaption", {}, `pin ${pin.number}, north up; its ellipse: ${within(ce90_m)}`));
    figure.hidden = false;
  }, () => undefined);
  return { figure, settled };
}

/** Asks for the surveyed coordinate of what was clicked. */
export function showTie(click: ClickBody, state: State, done: (tie: Tie) => void): void {
  const dialog = byId<HTMLDialogElement>("tie-dialog"), form = byId<HTMLFormElement>("tie-form"), result = byId("tie-result");
  form.reset();
  tieField ??= new CoordinateField(form.elements.namedItem("place") as HTMLInputElement, byId("tie-echo"));
  const field = tieField;
  byId("tie-echo").textContent = result.textContent = "";
  byId("tie-spot").textContent = `pixel ${click.u.toFixed(1)}, ${click.v.toFixed(1)} of picture ${click.frame}`;
  const value = (name: string): string => (form.elements.namedItem(name) as HTMLInputElement | HTMLSelectElement).value.trim();
  form.onsubmit = (event) => {
    event.preventDefault();
    const height = value("height") === "" ? null : Number(value("height"));
    result.textContent = "trying ...";
    field.read().then((place) => api.addTie({
      click, lat_deg: place.lat_deg, lon_deg: place.lon_deg, sigma_m: Number(value("sigma")), name: value("name"), who: state.options.who,
      height_m: height, datum: value("datum"), sigma_height_m: height === null ? null : Number(value("sigma-height")),
    })).then((reply) => {
      if (reply.tie !== null) { dialog.close(); done(reply.tie); return; }
      result.textContent = reply.reason ?? [reply.answer?.reason, reply.answer?.advice].filter(Boolean).join("; ");
    }, (error: unknown) => { result.textContent = error instanceof Refused ? error.message : String(error); });
  };
  dialog.showModal();
}

export function listTies(state: State, removed: () => void): void {
  const list = byId("tie-list");
  byId("no-ties").hidden = state.ties.length > 0;
  list.replaceChildren(...state.ties.map((tie) => make("li", {},
    `${tie.name === "" ? "known place" : tie.name}: ${degrees(tie.lat_deg, tie.lon_deg, tie.sigma_m)} ±${tie.sigma_m} m (1σ), ${tie.vehicle}, picture ${tie.frame} `,
    make("button", { type: "button", click: () => void api.deleteTie(tie.id, state.options.who).then(removed) }, "Remove"))));
}

export function closers(): void {
  for (const button of document.querySelectorAll<HTMLButtonElement>("dialog [data-close]")) {
    button.addEventListener("click", () => button.closest("dialog")?.close());
  }
  byId("print").addEventListener("click", () => window.print());
}
