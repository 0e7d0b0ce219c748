// What a machine found: in the picture, and as a list that waits for a person; new ones alarm by sound and colour.

import { api } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { within } from "./format.js";
import { toPane, type Pixel, type View } from "./mapping.js";
import { shortFind } from "./map-tracks.js";
import { placeIn } from "./projection.js";
import { newFinds } from "./news.js";
import type { State } from "./state.js";
import type { FoundSpot, FrameView } from "./types.js";

const SAME_PLACE_MS = 2000; // for which what moves is about where it was seen
const ALARM_MS = 8000; // for which a new find stands out
const TONES_HZ = [880, 660, 880], TONE_S = 0.16, LOUD = 0.25;

export interface FoundActions { goTo(spot: FoundSpot): void; confirm(spot: FoundSpot): void; dismiss(spot: FoundSpot): void }

/** A ring about each find that waits for a person, in any picture that shows it, or its place. */
export class SpotMarks {
  private readonly elements = new Map<number, HTMLElement>();

  constructor(private readonly layer: HTMLElement, private readonly state: State) {}

  draw(frame: FrameView | null, view: View): void {
    const seen = new Set<number>();
    for (const spot of frame === null || frame.camera === null ? [] : this.state.openSpots()) {
      const at = pixelOf(frame!, spot);
      if (at === null) continue;
      seen.add(spot.spot);
      let element = this.elements.get(spot.spot);
      if (element === undefined) {
        element = make("div", { class: "spot-mark", "data-testid": "spot-mark" }, make("b", {}));
        this.elements.set(spot.spot, element);
        this.layer.append(element);
      }
      const { x, y } = toPane(view, at);
      element.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
      setText(element.firstElementChild as HTMLElement, `${spot.spot} ${shortFind(spot)}`);
    }
    for (const [spot, element] of this.elements) if (!seen.has(spot)) { element.remove(); this.elements.delete(spot); }
  }
}

/** The pixel at which a picture shows a find. The place of one that moves is that of its last sighting, and no other picture's. */
function pixelOf(frame: FrameView, spot: FoundSpot): Pixel | null {
  const own = frame.spots[spot.spot];
  if (own !== undefined) {
    const [u, v] = own; // a second camera may see beyond this picture
    return u < 0.0 || v < 0.0 || u > frame.width_px - 1 || v > frame.height_px - 1 ? null : { u, v };
  }
  const apartMs = Math.abs(Date.parse(frame.time_utc) - Date.parse(spot.last_utc));
  return spot.is_moving === true && apartMs > SAME_PLACE_MS ? null : placeIn(frame, spot);
}

export class FoundList {
  private readonly element = byId("found-list");
  private readonly count = make("span", { "data-testid": "found-count" });
  private readonly mute = make("button", { type: "button", "data-testid": "mute", click: () => this.state.set({ isMuted: !this.state.options.isMuted }) });
  private readonly rows = new Map<number, HTMLElement>();
  private readonly known = new Map<number, string>(); // by number, when it was first seen
  private isBegun = false; // what was there when the page was opened is no news
  private quiet = 0;

  constructor(private readonly state: State, private readonly actions: FoundActions) {
    this.element.append(make("div", { class: "found-head" }, this.count, make("span", { class: "spring" }), this.mute));
    state.on(["spots"], () => this.draw());
    state.on(["options"], () => this.drawMute());
    this.drawMute();
  }

  private drawMute(): void {
    const { isMuted } = this.state.options;
    setText(this.mute, isMuted ? "Sound off" : "Sound on");
    this.mute.setAttribute("aria-pressed", String(isMuted));
    this.mute.title = "whether a new hot spot makes a sound";
  }

  private draw(): void {
    const spots = this.state.openSpots(), open = new Set(spots.map((spot) => spot.spot));
    const news = newFinds(this.known, spots);
    spots.forEach((spot, k) => {
      let row = this.rows.get(spot.spot);
      if (row === undefined) {
        row = this.row(spot);
        this.rows.set(spot.spot, row);
        this.element.append(row);
      }
      row.style.order = String(k);
      this.fill(row, spot);
    });
    for (const [spot, row] of this.rows) if (!open.has(spot)) { row.remove(); this.rows.delete(spot); }
    const first = spots[0], most = first === undefined ? "" : `, the ${first.kind === null ? "hottest" : "likeliest"} ${shortFind(first)}`;
    setText(this.count, `Hot spots ${spots.length}${most}`);
    this.element.hidden = spots.length === 0;
    if (this.isBegun && news.length > 0) this.alarm(news);
    this.isBegun = true;
  }

  private alarm(news: readonly FoundSpot[]): void {
    this.element.dataset["alarm"] = "yes";
    for (const spot of news) this.rows.get(spot.spot)?.setAttribute("data-news", "yes");
    window.clearTimeout(this.quiet);
    this.quiet = window.setTimeout(() => {
      this.element.dataset["alarm"] = "no";
      for (const row of this.rows.values()) row.removeAttribute("data-news");
    }, ALARM_MS);
    if (!this.state.options.isMuted) sound();
  }

  private row(spot: FoundSpot): HTMLElement {
    const now = (): FoundSpot => this.state.spots.get(spot.spot) ?? spot;
    const press = (label: string, title: string, id: string, run: () => void): HTMLButtonElement =>
      make("button", { type: "button", class: "only-operators", title, "data-testid": id, click: run }, label);
    const crop = make("img", { class: "crop", alt: "the picture about it" });
    crop.addEventListener("error", () => crop.classList.add("none"));
    return make("div", { class: "track-row found-row", "data-testid": "found", "data-spot": String(spot.spot) }, crop,
      make("button", { type: "button", class: "track-words", title: "show its best picture, and it on the map", click: () => this.actions.goTo(now()) }),
      press("Confirm", "it is something: a pin of the chosen kind", "confirm", () => this.actions.confirm(now())),
      press("Dismiss", "it is nothing: not shown again", "dismiss", () => this.actions.dismiss(now())));
  }

  private fill(row: HTMLElement, spot: FoundSpot): void {
    const [crop, words] = [...row.children] as [HTMLImageElement, HTMLElement];
    const url = api.spotCropUrl(spot);
    if (crop.getAttribute("src") !== url) { crop.classList.remove("none"); crop.setAttribute("src", url); }
    const above = spot.above_ground_k, isHeat = spot.kind === null && spot.temperature_c !== null && above !== null;
    const hot = isHeat ? `${shortFind(spot)} (${above >= 0 ? "+" : ""}${above.toFixed(1)} K)` : spot.heat;
    setText(words, `${spot.spot}  ${hot}, ${within(spot.ce90_m)}, ${spot.motion}, seen in ${spot.pictures} picture${spot.pictures === 1 ? "" : "s"}`);
  }
}

/** Three short tones. A browser plays none before the page was touched once: the colour alone alarms then. */
function sound(): void {
  try {
    const audio = new AudioContext(), gain = audio.createGain();
    gain.gain.value = LOUD;
    gain.connect(audio.destination);
    TONES_HZ.forEach((hz, k) => {
      const tone = audio.createOscillator();
      tone.frequency.value = hz;
      tone.connect(gain);
      tone.start(audio.currentTime + k * TONE_S);
      tone.stop(audio.currentTime + (k + 0.8) * TONE_S);
      if (k === TONES_HZ.length - 1) tone.onended = () => void audio.close();
    });
  } catch { /* without a loudspeaker */ }
}
