// Asking that what was clicked is followed, the boxes of what is followed in the picture, and the list of it.

import { api, Refused } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { toPane, type Size, type View } from "./mapping.js";
import { PHASE_COLOURS } from "./map-tracks.js";
import type { State } from "./state.js";
import { seenIn, trackWords, type TrackNow } from "./tracks.js";
import type { ClickBody, FrameView } from "./types.js";

const LEAST_BOX_PX = 26; // on the screen: of a small thing the box is larger than it, or it could not be seen
const TICK_MS = 1000; // what is no longer reported is seen to have ended

type Show = (text: string, kind: "ok" | "refused" | "note") => void;

/** What was clicked last can be followed: by a button next to its answer, or the key G. */
export class Following {
  private last: ClickBody | null = null;
  private isAsking = false;

  constructor(private readonly state: State, private readonly show: Show) {}

  /** A click was answered, with a place or without: it may be followed. */
  clicked(body: ClickBody): void {
    this.last = body;
    if (!this.state.mayChange || this.unfollowed(body) !== "") return; // the key G states why
    const button = make("button", { type: "button", class: "follow-it", "data-testid": "follow-it", title: "the aircraft follows what was clicked (G)", click: () => void this.begin() }, "Follow");
    byId("answer").append(button);
  }

  private unfollowed(body: ClickBody): string {
    return this.state.vehicles.find((vehicle) => vehicle.id === body.vehicle)?.unfollowed ?? "no aircraft of that name is known";
  }

  async begin(): Promise<void> {
    const body = this.last;
    if (body === null) { this.show("Click what is to be followed first.", "note"); return; }
    const reason = this.unfollowed(body);
    if (reason !== "") { this.show(`Not followed: ${reason}.`, "refused"); return; }
    if (this.isAsking) return;
    this.isAsking = true;
    this.show("Asking the aircraft to follow it ...", "note");
    try {
      const reply = await api.follow(body);
      this.show(`Followed as track ${reply.track} of ${reply.vehicle}: its box is in the picture, its path on the map.`, "ok");
    } catch (error) {
      this.show(`Not followed: ${error instanceof Refused ? error.message : String(error)}`, "refused");
    } finally {
      this.isAsking = false;
    }
  }
}

/** A box about each thing that is followed, in whatever picture is shown. */
export class TrackBoxes {
  private readonly boxes = new Map<string, HTMLElement>();

  constructor(private readonly layer: HTMLElement, private readonly state: State) {}

  draw(frame: FrameView | null, view: View, pane: Size): void {
    const seen = new Set<string>();
    for (const track of frame === null ? [] : this.state.tracksNow()) {
      const found = frame === null ? null : seenIn(track, frame);
      if (found === null) continue;
      const { x, y } = toPane(view, found.at), side = Math.max(found.size * view.scale, LEAST_BOX_PX);
      if (x < -side || y < -side || x > pane.width + side || y > pane.height + side) continue;
      seen.add(track.key);
      this.put(track, x, y, side);
    }
    for (const [key, element] of this.boxes) if (!seen.has(key)) { element.remove(); this.boxes.delete(key); }
  }

  private put(track: TrackNow, x: number, y: number, side: number): void {
    let element = this.boxes.get(track.key);
    if (element === undefined) {
      element = make("div", { class: "track-box", "data-testid": "track-box", "data-track": track.key }, make("b", {}));
      this.boxes.set(track.key, element);
      this.layer.append(element);
    }
    element.dataset["phase"] = track.phase;
    element.style.width = element.style.height = `${side.toFixed(1)}px`;
    element.style.transform = `translate(${(x - side / 2).toFixed(1)}px, ${(y - side / 2).toFixed(1)}px)`;
    setText(element.firstElementChild as HTMLElement, String(track.number));
  }
}

export interface TrackActions { goTo(lat: number, lon: number): void; failed(error: unknown): void }

/** All tracks with how they are, above the pins; each can be ended here. */
export class TrackList {
  private readonly element = byId("track-list");
  private readonly rows = new Map<string, HTMLElement>();

  constructor(private readonly state: State, private readonly actions: TrackActions) {
    state.on(["tracks", "shown", "vehicles"], () => this.draw());
    window.setInterval(() => { if (this.rows.size > 0) state.notify("tracks"); }, TICK_MS);
  }

  private draw(): void {
    const now = this.state.tracksNow(), seen = new Set<string>(), isLive = this.state.server?.is_live === true;
    for (const track of now) {
      seen.add(track.key);
      let row = this.rows.get(track.key);
      if (row === undefined) {
        row = this.row(track);
        this.rows.set(track.key, row);
        this.element.append(row);
      }
      const [sign, go, end] = [...row.children] as HTMLElement[];
      row.dataset["phase"] = track.phase;
      sign!.style.background = PHASE_COLOURS[track.phase];
      setText(go!, `${this.state.vehicles.length > 1 ? `${track.vehicle} ` : ""}${track.number}  ${trackWords(track)}`);
      end!.hidden = !isLive || !this.state.mayChange || track.phase === "lost" || track.phase === "ended";
    }
    for (const [key, row] of this.rows) if (!seen.has(key)) { row.remove(); this.rows.delete(key); }
    this.element.hidden = this.rows.size === 0;
  }

  private row(track: TrackNow): HTMLElement {
    const { key, vehicle, number } = track;
    const go = make("button", { type: "button", class: "track-words", "data-testid": "track-words", title: "show it on the map", click: () => {
      const place = this.state.tracksNow().find((one) => one.key === key)?.path.findLast((report) => report.place !== null)?.place;
      if (place != null) this.actions.goTo(place.lat_deg, place.lon_deg);
    } });
    const end = make("button", { type: "button", "data-testid": "track-end", "aria-label": `end track ${number}`, title: "follow it no longer", click: () => {
      end.disabled = true;
      api.endTrack(vehicle, number).catch((error: unknown) => this.actions.failed(error)).finally(() => { end.disabled = false; });
    } }, "End");
    return make("div", { class: "track-row", role: "listitem", "data-testid": "track", "data-track": key }, make("i", { class: "swatch" }), go, end);
  }
}
