// The page of pc-ground web: puts the panes together.

import "./style.css";
import { api, listen } from "./api.js";
import { wireAdding } from "./adding.js";
import { AgeBadge } from "./badge.js";
import { Clicking } from "./clicking.js";
import { Coordinates } from "./coordinate.js";
import { closers, listTies, showHandoff } from "./dialogs.js";
import { byId, make, setText } from "./dom.js";
import { Following, TrackList } from "./following.js";
import { Looking } from "./looking.js";
import { FoundList } from "./found.js";
import { clock } from "./format.js";
import type { MapPane } from "./map.js";
import { layersMenu } from "./menu.js";
import { PicturePane } from "./picture.js";
import { PinList } from "./pins.js";
import { Readout } from "./readout.js";
import { KINDS, shapeSvg } from "./shapes.js";
import { LARGE, State, type Large, type Peek } from "./state.js";
import { StatusStrip } from "./strip.js";
import { TileArea } from "./tile-area.js";
import { TimeMarks } from "./time-marks.js";
import type { News, Pin, SeenPicture, ServerEvent } from "./types.js";
import { Viewer } from "./viewer.js";

const state = new State();
const viewer = new Viewer(state);
let mapPane: MapPane | null = null;

const coordinates = new Coordinates(state);
const clicking = new Clicking(state, coordinates);
const picture = new PicturePane(state, viewer, new Readout(state), (body) => void clicking.clicked(body, picture));
const following = new Following(state, (text, kind) => clicking.show(text, kind));
clicking.following = following;
const looking = new Looking(state, (text, kind) => clicking.show(text, kind));
clicking.looking = looking;
const showMessage = (text: string, kind: "ok" | "refused" | "note" = "note"): void => clicking.show(text, kind);

async function refresh(): Promise<void> {
  const status = await api.status();
  state.server = status;
  state.setVehicles(status.vehicles);
  if (state.vehicle === null && status.vehicles[0] !== undefined) state.vehicle = status.vehicles[0].id;
  setText(byId("source"), status.is_live ? `live: ${status.source}` : `recording: ${status.source.split("/").at(-1) ?? ""}`);
  byId("source").title = status.source;
  document.body.classList.toggle("recorded", !status.is_live);
  document.body.dataset["role"] = status.role;
  await Promise.all([refreshPins(), refreshNews("tracks"), refreshNews("spots"), ...status.vehicles.map((vehicle) => refreshFrames(vehicle.id))]);
  state.notify("vehicles");
}

async function refreshFrames(vehicle: string): Promise<void> {
  const [rows, path] = await Promise.all([api.frames(vehicle), api.path(vehicle)]);
  state.frames.set(vehicle, []);
  state.paths.set(vehicle, path);
  state.merge(vehicle, rows);
}

async function refreshNews<K extends keyof News>(what: K): Promise<void> { state.put(what, await api.all(what), true); }

let isRefreshing = false, isRefreshDue = false;
async function refreshPins(): Promise<void> {
  if (isRefreshing) { isRefreshDue = true; return; }
  isRefreshing = true;
  try {
    const { pins, ties, revision } = await api.pins();
    state.ties = ties;
    state.setPins(pins, revision);
    if (state.selected !== null && !state.pins.has(state.selected)) state.select(null);
    listTies(state, () => undefined);
  } finally {
    isRefreshing = false;
    if (isRefreshDue) { isRefreshDue = false; void refreshPins(); }
  }
}

function onEvent(event: ServerEvent): void {
  switch (event.type) {
    case "frames":
      if (!state.vehicles.some((vehicle) => vehicle.id === event.vehicle)) { void refresh(); return; }
      lengthenPath(event.vehicle);
      state.merge(event.vehicle, event.frames);
      return;
    case "pin": state.putPin(event.pin, event.revision); decided(); return;
    case "pin_deleted": state.dropPin(event.id, event.revision); decided(); return;
    case "pins": void refreshPins(); decided(); return;
    case "spots": state.put("spots", event.spots); return;
    case "tracks": state.put("tracks", event.tracks); return;
    case "resync": void refresh(); return;
    case "status":
      state.setVehicles(event.vehicles);
      drawNotes(event.sharing, event.damage);
      if (state.vehicle === null && event.vehicles[0] !== undefined) void refresh();
      state.notify("vehicles");
  }
}

/** A pin may be what somebody decided of a machine's find. */
function decided(): void { if (state.spots.size > 0) void refreshNews("spots"); }

/** The state of sharing, and what of the source cannot be read. */
function drawNotes(sharing: string, damage: string[]): void {
  const notes = [...(sharing === "" ? [] : [`shared: ${sharing}`]), ...damage];
  byId("notes").hidden = notes.length === 0;
  setText(byId("notes"), notes.join("\n"));
}

/** The path grows by what is shown; the whole of it is asked for from time to time. */
const askedAt = new Map<string, number>();
function lengthenPath(vehicle: string): void {
  const now = performance.now();
  if (now - (askedAt.get(vehicle) ?? -Infinity) < 5000) return;
  askedAt.set(vehicle, now);
  api.path(vehicle).then((path) => { state.paths.set(vehicle, path); state.notify("frames"); }, () => undefined);
}

const timeBar = byId<HTMLInputElement>("time-bar");
function drawControls(): void {
  const rows = state.rows(), at = viewer.index();
  timeBar.max = String(Math.max(rows.length - 1, 0));
  timeBar.value = String(at);
  timeBar.disabled = rows.length < 2;
  const shown = state.shown;
  const isRefused = shown !== null && shown.status !== "ok";
  const where = shown === null ? "" : `picture ${shown.frame}  ${clock(shown.capture_unix_ns)}`;
  setText(byId("frame-label"), where);
  timeBar.setAttribute("aria-valuetext", where);
  const banner = byId("banner");
  banner.hidden = !isRefused;
  setText(banner, isRefused ? `This picture cannot be clicked: ${shown.reason}. ${shown.advice === "" ? "" : `What helps: ${shown.advice}.`}` : "");
  byId("freeze").setAttribute("aria-pressed", String(state.isFrozen));
  setText(byId("freeze-label"), state.isFrozen ? "Frozen" : "Freeze");
  byId("play").setAttribute("aria-pressed", String(state.isPlaying));
  setText(byId("play-label"), state.isPlaying ? "Pause" : "Play");
}

function drawMode(): void {
  const text = state.mode.kind === "tie" ? "Click a place in the picture whose coordinate is known (Esc: leave it)"
    : state.mode.kind === "again" ? `Click the thing of pin ${state.pins.get(state.mode.pin)?.number ?? ""} again (Esc: leave it)` : "";
  const hint = byId("mode-hint");
  hint.hidden = text === "";
  setText(hint, text);
  byId("tie").setAttribute("aria-pressed", String(state.mode.kind === "tie"));
}

function drawOptions(): void {
  const { options } = state;
  const isDark = options.theme === "night" || (options.theme === "auto" && window.matchMedia("(prefers-color-scheme: dark)").matches);
  document.documentElement.dataset["theme"] = isDark ? "night" : "day";
  mapPane?.setTheme(isDark ? "night" : "day");
  for (const [id, on] of [["show-features", state.peeks.has("features")], ["show-paths", state.peeks.has("paths")], ["show-pictures", options.pictures]] as const) {
    byId(id).setAttribute("aria-pressed", String(on));
  }
  if (document.body.dataset["view"] !== options.view) {
    document.body.dataset["view"] = options.view;
    mapPane?.resize();
  }
  for (const button of byId("views").children) button.setAttribute("aria-pressed", String((button as HTMLElement).dataset["view"] === options.view));
  byId<HTMLInputElement>("who").value = options.who;
  byId<HTMLSelectElement>("theme").value = options.theme;
  for (const button of byId("kinds").children) button.setAttribute("aria-pressed", String((button as HTMLElement).dataset["kind"] === options.category));
}

/** Which of map and pins a phone shows under the picture. */
function showTab(tab: string): void {
  document.body.dataset["tab"] = tab;
  for (const one of ["map", "pins"]) byId(`tab-${one}`).setAttribute("aria-pressed", String(one === tab));
  mapPane?.resize();
}

function handOff(pin: Pin): void { run(showHandoff(pin, state, mapPane)); }

/** Open a picture and show where in it a place of the map is. */
async function openSeen(seen: SeenPicture, lat: number, lon: number): Promise<void> {
  const { vehicle, session, frame } = seen;
  viewer.open(vehicle, frame);
  const { u_px: u, v_px: v } = await api.seenPixel(seen, lat, lon);
  picture.markers.look({ key: "looked for", vehicle, session, frame, at: { u, v } });
  picture.reveal({ u, v });
}

function select(id: string | null): void {
  document.body.classList.toggle("has-card", id !== null);
  if (id !== null) showTab("pins");
  const pin = id === null ? undefined : state.pins.get(id);
  if (pin?.place.status === "ok") mapPane?.goTo(pin.place.lat_deg, pin.place.lon_deg);
}

async function undo(isRedo: boolean): Promise<void> {
  try {
    const change = isRedo ? (await api.redo(state.options.who)).redone : (await api.undo(state.options.who)).undone;
    showMessage(change === null ? `nothing to ${isRedo ? "do again" : "undo"}` : `${isRedo ? "done again" : "undone"}: ${change}`);
    await refreshPins();
  } catch (error) {
    showMessage(error instanceof Error ? error.message : String(error), "refused");
  }
}

function run(what: Promise<unknown>): void {
  what.catch((error: unknown) => showMessage(error instanceof Error ? error.message : String(error), "refused"));
}

function wire(): void {
  for (const kind of KINDS) {
    byId("kinds").append(make("button", { type: "button", class: "kind", "data-kind": kind.word, title: `the next pin is a ${kind.title.toLowerCase()} (${KINDS.indexOf(kind) + 1})`, click: () => state.set({ category: kind.word }) }, shapeSvg(kind, 20), make("span", {}, kind.word === "poi" ? "POI" : kind.title)));
  }
  const press = (id: string, action: () => void): void => byId(id).addEventListener("click", action);
  press("freeze", () => viewer.freeze(!state.isFrozen));
  press("step-back", () => viewer.step(-1));
  press("step-forward", () => viewer.step(1));
  press("play", () => { if (state.isPlaying) viewer.pause(); else viewer.play(); });
  press("zoom-in", () => picture.zoom(1.5));
  press("zoom-out", () => picture.zoom(1 / 1.5));
  for (const what of ["features", "paths"] as Peek[]) press(`show-${what}`, () => state.peek(what));
  for (const tab of ["map", "pins"]) press(`tab-${tab}`, () => showTab(tab));
  press("more", () => byId("more").setAttribute("aria-expanded", String(document.body.classList.toggle("more"))));
  for (const button of byId("views").children) button.addEventListener("click", () => state.set({ view: (button as HTMLElement).dataset["view"] as Large }));
  layersMenu();
  press("show-pictures", () => state.set({ pictures: !state.options.pictures }));
  press("undo", () => void undo(false));
  press("redo", () => void undo(true));
  press("tie", () => state.setMode(state.mode.kind === "tie" ? { kind: "pin" } : { kind: "tie" }));
  press("ties", () => { listTies(state, () => undefined); byId<HTMLDialogElement>("ties-dialog").showModal(); });
  press("export", () => byId<HTMLDialogElement>("export-dialog").showModal());
  press("report", () => { byId<HTMLAnchorElement>("report").href = `/api/report?who=${encodeURIComponent(state.options.who)}`; });
  press("help", () => byId<HTMLDialogElement>("help-dialog").showModal());
  timeBar.addEventListener("input", () => viewer.goTo(Number(timeBar.value)));
  byId<HTMLInputElement>("who").addEventListener("change", (event) => state.set({ who: (event.target as HTMLInputElement).value.trim() }));
  byId<HTMLSelectElement>("theme").addEventListener("change", (event) => state.set({ theme: (event.target as HTMLSelectElement).value as "auto" | "day" | "night" }));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawOptions);
  closers();
  wireAdding(state, (words) => showMessage(words));
  showTab("pins");
  document.addEventListener("keydown", keyed);
  state.on(["shown", "frames"], drawControls);
  state.on(["options"], drawOptions);
  state.on(["mode"], drawMode);
  state.on(["selected"], () => select(state.selected));
}

function keyed(event: KeyboardEvent): void {
  const at = event.target;
  const isTyping = at instanceof HTMLInputElement && at.type !== "range" || at instanceof HTMLTextAreaElement || at instanceof HTMLSelectElement;
  if (event.key === "Escape" && state.mode.kind !== "pin") { state.setMode({ kind: "pin" }); return; }
  if (isTyping || event.altKey || document.querySelector("dialog[open]") !== null) return;
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z") { event.preventDefault(); void undo(event.shiftKey); return; }
  if (event.ctrlKey || event.metaKey) return;
  if (picture.key(event.key.length === 1 ? event.key.toLowerCase() : event.key, event.shiftKey)) { event.preventDefault(); return; }
  const selected = state.selected === null ? undefined : state.pins.get(state.selected);
  const actions: Record<string, () => void> = {
    " ": () => viewer.freeze(!state.isFrozen), ArrowLeft: () => viewer.step(-1), ArrowRight: () => viewer.step(1),
    "+": () => picture.zoom(1.5), "-": () => picture.zoom(1 / 1.5), "0": () => picture.whole(),
    m: () => state.set({ view: LARGE[(LARGE.indexOf(state.options.view) + 1) % LARGE.length]! }),
    f: () => state.peek("features"), p: () => state.peek("paths"),
    "/": () => byId("filter").focus(), "?": () => byId<HTMLDialogElement>("help-dialog").showModal(),
    u: () => void undo(false), g: () => void following.begin(), t: () => state.setMode({ kind: "tie" }), h: () => { if (selected !== undefined) handOff(selected); },
  };
  KINDS.forEach((kind, k) => { actions[String(k + 1)] = () => state.set({ category: kind.word }); });
  // Space presses the button that has the focus; elsewhere it freezes.
  if (event.key === " " && at instanceof HTMLButtonElement) return;
  const action = actions[event.key];
  if (action !== undefined) { event.preventDefault(); action(); }
}

async function begin(): Promise<void> {
  new StatusStrip(state, viewer, looking);
  new AgeBadge(state);
  new TimeMarks(state);
  new TileArea(() => mapPane);
  new PinList(state, coordinates, {
    handoff: handOff,
    open: (vehicle, frame, u, v) => { viewer.open(vehicle, frame); picture.reveal({ u, v }); },
    remove: (pin) => run(api.deletePin(pin.id, state.options.who).then(() => showMessage(`pin ${pin.number} deleted; Undo brings it back`))),
    edit: (pin, changed) => run(api.editPin(pin.id, { ...changed, who: state.options.who })),
    removeClick: (pin, click) => run(api.removeClick(pin.id, click, state.options.who)),
    goTo: (pin) => { const click = pin.clicks.at(-1); if (click?.frame != null) viewer.open(click.vehicle, click.frame); },
  });
  new FoundList(state, {
    goTo: (spot) => { viewer.open(spot.best.vehicle, spot.best.frame); mapPane?.goTo(spot.lat_deg, spot.lon_deg); },
    confirm: (spot) => run(api.confirmSpot(spot.spot, { category: state.options.category, who: state.options.who }).then((pin) => { showMessage(`hot spot ${spot.spot} is pin ${pin.number}`); })),
    dismiss: (spot) => run(api.dismissSpot(spot.spot, state.options.who).then(() => { showMessage(`hot spot ${spot.spot} is dismissed; Undo brings it back as a pin`); })),
  });
  new TrackList(state, {
    goTo: (lat, lon) => { showTab("map"); mapPane?.goTo(lat, lon); },
    failed: (error) => showMessage(`Not ended: ${error instanceof Error ? error.message : String(error)}`, "refused"),
  });
  wire();
  drawOptions();
  drawControls();
  let isBegun = false;
  listen(onEvent, () => {
    state.isConnected = true;
    byId("offline").hidden = true;
    state.forgetRevisions();
    if (isBegun) run(refresh());
    state.notify("link");
  }, () => {
    state.isConnected = false;
    byId("offline").hidden = false;
    state.notify("link");
  });
  try {
    await refresh();
  } catch (error) {
    showMessage(error instanceof Error ? error.message : String(error), "refused");
  }
  isBegun = true;
  try {
    await beginMap();
  } catch {
    // Pictures, clicks and pins need no graphics card.
    byId("no-map").hidden = false;
  }
  drawOptions();
  document.body.dataset["ready"] = "yes";
}

/** Nine tenths of the page's code is the map's: it is fetched with the first picture, and started after it. */
async function beginMap(): Promise<void> {
  const fetched = import("./map.js");
  if (state.shown === null && state.rows().length > 0) {
    await new Promise<void>((done) => {
      state.on(["shown"], done);
      window.setTimeout(done, 1000);
    });
  }
  const { MapPane, baseMap } = await fetched, tiles = state.server?.tiles ?? null;
  const base = tiles === null ? null : await baseMap(tiles).catch((error: unknown) => { showMessage(`no base map: ${String(error)}`, "refused"); return null; });
  mapPane = new MapPane(state, viewer, base, (picture, lat, lon) => run(openSeen(picture, lat, lon)));
}

void begin();
