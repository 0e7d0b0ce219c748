// Pins in the picture: where they were clicked, or where their places are seen from it; and a click's answer at its spot.

import { make } from "./dom.js";
import { contains, toPane, type Pixel, type Point, type Size, type View } from "./mapping.js";
import { pixelOf } from "./projection.js";
import { kindOf, shapeSvg } from "./shapes.js";
import type { State } from "./state.js";
import type { Category, FrameView, Pin } from "./types.js";

const NEAR_PX = 16;
const MOST = 200; // in one picture, the newest first

interface Spot { readonly key: string; readonly vehicle: string; readonly session: number; readonly frame: number; readonly at: Pixel }

/** A click under way, or refused: it has no pin yet, or never will. */
export interface Pending extends Spot { readonly number: number; readonly category: Category; text: string; isRefused: boolean }

interface Drawn { element: HTMLElement; look: string; x: number; y: number }

export class Markers {
  private readonly drawn = new Map<string, Drawn>();
  private readonly pending = new Map<string, Pending>();
  private last: [FrameView | null, View, Size] | null = null;
  private readonly bubble = make("div", { class: "bubble", hidden: true });

  private newest: Pin[] | null = null;

  constructor(private readonly layer: HTMLElement, private readonly state: State) {
    state.on(["pins"], () => { this.newest = null; });
    layer.append(this.bubble);
  }

  /** At once, without waiting for the next frame of the screen. */
  begin(pending: Pending): void {
    this.pending.set(pending.key, pending);
    this.hideBubble();
    this.redraw();
  }

  done(key: string): void {
    this.pending.delete(key);
    this.redraw();
  }

  /** Only one refusal is shown at a time: at its spot, until the next click. */
  refuse(key: string, text: string): void {
    for (const [other, held] of this.pending) if (held.isRefused) this.pending.delete(other);
    const held = this.pending.get(key);
    if (held !== undefined) { held.isRefused = true; held.text = text; }
    this.redraw();
  }

  clearRefusals(): void {
    for (const [key, held] of this.pending) if (held.isRefused) this.pending.delete(key);
    this.redraw();
  }

  near(at: Point): string | null {
    let best: string | null = null, least = NEAR_PX;
    for (const [key, { x, y }] of this.drawn) {
      const far = Math.hypot(x - at.x, y - at.y);
      if (far < least && this.state.pins.has(key)) { least = far; best = key; }
    }
    return best;
  }

  draw(frame: FrameView | null, view: View, pane: Size): void {
    this.last = [frame, view, pane];
    const seen = new Set<string>();
    this.hideBubble();
    if (frame !== null) {
      const size = { width: frame.width_px, height: frame.height_px };
      for (const pin of this.shownPins()) {
        const at = pixelIn(pin, frame, size);
        if (at === null) continue;
        const isMarked = pin.id === this.state.hovered || pin.id === this.state.selected;
        const look = `${pin.category} ${pin.number} ${isMarked} ${pin.place.status}`;
        this.put(pin.id, look, toPane(view, at), pane, () => marker(pin.category, String(pin.number), isMarked, pin.place.status === "ok" ? "" : "!"));
        seen.add(pin.id);
      }
      for (const p of this.pending.values()) {
        if (p.vehicle !== frame.vehicle || p.session !== frame.session || p.frame !== frame.frame || !contains(size, p.at)) continue;
        const at = toPane(view, p.at);
        const look = `${p.category} ${p.number} ${p.isRefused}`;
        this.put(p.key, look, at, pane, () => (p.isRefused ? refusal() : marker(p.category, String(p.number), true, "")));
        seen.add(p.key);
        if (p.isRefused) this.showBubble(p.text, at, pane);
      }
    }
    for (const [key, { element }] of this.drawn) {
      if (!seen.has(key)) { element.remove(); this.drawn.delete(key); }
    }
  }

  private redraw(): void {
    if (this.last !== null) this.draw(...this.last);
  }

  /** Sorted anew only when pins have changed: a picture is drawn far more often. */
  private shownPins(): Pin[] {
    if (this.newest === null) {
      const all = [...this.state.pins.values()];
      this.newest = all.length <= MOST ? all : all.sort((a, b) => b.number - a.number).slice(0, MOST);
    }
    return this.newest;
  }

  private put(key: string, look: string, at: Point, pane: Size, made: () => HTMLElement): void {
    let held = this.drawn.get(key);
    if (held === undefined || held.look !== look) {
      held?.element.remove();
      held = { element: made(), look, x: 0, y: 0 };
      this.layer.append(held.element);
      this.drawn.set(key, held);
    }
    held.x = at.x;
    held.y = at.y;
    held.element.style.transform = `translate(${at.x}px, ${at.y}px)`;
    held.element.classList.toggle("below", at.y < 38);
    held.element.style.visibility = at.x < 0 || at.y < 0 || at.x > pane.width || at.y > pane.height ? "hidden" : "visible";
  }

  private showBubble(text: string, at: Point, pane: Size): void {
    this.bubble.textContent = text;
    this.bubble.hidden = false;
    const isRight = at.x > pane.width / 2, isLow = at.y > pane.height / 2;
    this.bubble.style.left = isRight ? "auto" : `${Math.max(at.x - 10, 4)}px`;
    this.bubble.style.right = isRight ? `${Math.max(pane.width - at.x - 10, 4)}px` : "auto";
    this.bubble.style.top = isLow ? "auto" : `${at.y + 18}px`;
    this.bubble.style.bottom = isLow ? `${pane.height - at.y + 18}px` : "auto";
  }

  private hideBubble(): void {
    this.bubble.hidden = true;
  }
}

/** Where a pin is in a picture: at its click, if it was clicked there; else where its place is seen. */
export function pixelIn(pin: Pin, frame: FrameView, size: Size): Pixel | null {
  for (const click of pin.clicks) {
    if (click.vehicle === frame.vehicle && click.session === frame.session && click.frame === frame.frame && click.u_px !== null && click.v_px !== null) {
      return { u: click.u_px, v: click.v_px };
    }
  }
  const place = pin.place;
  if (frame.camera === null || place.status !== "ok") return null;
  const height = place.height_ellipsoid_m ?? place.height_amsl_m;
  return height === null ? null : pixelOf(frame.camera, size, place.lat_deg, place.lon_deg, height);
}

function marker(category: Category, number: string, isMarked: boolean, flag: string): HTMLElement {
  const kind = kindOf(category);
  const element = make("div", { class: `marker${isMarked ? " marked" : ""}`, "data-testid": "picture-pin", "data-number": number });
  element.append(make("i", { class: "spot" }), shapeSvg(kind, 26, number));
  if (flag !== "") element.append(make("b", { class: "flag" }, flag));
  return element;
}

function refusal(): HTMLElement {
  return make("div", { class: "marker refused" }, make("i", { class: "cross" }, "×"));
}
