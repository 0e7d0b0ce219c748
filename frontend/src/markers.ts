// Pins in the picture: where they were clicked, or where their places are seen from it; and a click's answer at its spot.

import { make } from "./dom.js";
import { contains, toPane, type Pixel, type Point, type Size, type View } from "./mapping.js";
import { placeIn } from "./projection.js";
import { kindOf, shapeSvg } from "./shapes.js";
import type { State } from "./state.js";
import type { Category, FrameView, Pin } from "./types.js";

const SPOT_PX = { mouse: 7, touch: 16 }, SHAPE_PX = { mouse: 11, touch: 14 }; // how far a press may be from it
const SHAPE_ABOVE_PX = 18, BELOW_UNDER_PX = 30; // a pin's shape stands so far above its spot; near the top, below
const MOST = 200; // in one picture, the newest first

export interface Spot { readonly key: string; readonly vehicle: string; readonly session: number; readonly frame: number; readonly at: Pixel }

/** A click under way, or refused: it has no pin yet, or never will. */
export interface Pending extends Spot { readonly number: number; readonly category: Category; text: string; isRefused: boolean }

interface Marker { element: HTMLElement; look: string; x: number; y: number; isSeen: boolean }

export class Markers {
  private readonly markers = new Map<string, Marker>();
  private readonly pending = new Map<string, Pending>();
  private looked: Spot | null = null; // a place that was looked for on the map
  private last: [FrameView | null, View, Size] | null = null;
  private readonly bubble = make("div", { class: "bubble", hidden: true });

  constructor(private readonly layer: HTMLElement, private readonly state: State) {
    layer.append(this.bubble);
  }

  /** At once, without waiting for the next frame of the screen. */
  begin(pending: Pending): void {
    this.pending.set(pending.key, pending);
    this.hideBubble();
    if (this.last === null) return;
    const [frame, view, pane] = this.last;
    if (frame !== null) this.putPending(pending, frame, view, pane);
  }

  /** From now on a place is ringed in the picture in which it was looked for. */
  look(spot: Spot): void {
    this.looked = spot;
    this.redraw();
  }

  /** Its pin is shown in its place with the next frame. */
  done(key: string): void { this.pending.delete(key); }

  /** Only one refusal is shown at a time: at its spot, until the next click. */
  refuse(key: string, text: string): void {
    for (const [other, held] of this.pending) if (held.isRefused) this.pending.delete(other);
    const held = this.pending.get(key);
    if (held !== undefined) { held.isRefused = true; held.text = text; }
    this.redraw();
  }

  clearRefusals(): void {
    let had = false;
    for (const [key, held] of this.pending) if (held.isRefused) { this.pending.delete(key); had = true; }
    if (had) this.redraw();
  }

  /** The pin whose spot or shape is pressed; null if there is none. */
  near(at: Point, isTouch: boolean): string | null {
    const kind = isTouch ? "touch" : "mouse";
    let best: string | null = null, least = 1;
    for (const [key, { x, y, isSeen }] of this.markers) {
      if (!isSeen || !this.state.pins.has(key)) continue;
      const shapeY = y < BELOW_UNDER_PX ? y + SHAPE_ABOVE_PX : y - SHAPE_ABOVE_PX;
      const far = Math.min(Math.hypot(x - at.x, y - at.y) / SPOT_PX[kind], Math.hypot(x - at.x, shapeY - at.y) / SHAPE_PX[kind]);
      if (far < least) { least = far; best = key; }
    }
    return best;
  }

  draw(frame: FrameView | null, view: View, pane: Size): void {
    this.last = [frame, view, pane];
    const seen = new Set<string>();
    this.hideBubble();
    if (frame !== null) {
      for (const pin of this.state.newestFirst().slice(0, MOST)) {
        const at = pixelIn(pin, frame);
        if (at === null) continue;
        const isMarked = pin.id === this.state.hovered || pin.id === this.state.selected;
        const look = `${pin.category} ${pin.number} ${isMarked} ${pin.place.status}`;
        this.put(pin.id, look, toPane(view, at), pane, () => marker(pin.category, String(pin.number), isMarked, pin.place.status === "ok" ? "" : "!"));
        seen.add(pin.id);
      }
      for (const p of this.pending.values()) if (this.putPending(p, frame, view, pane)) seen.add(p.key);
      const looked = this.looked;
      if (looked !== null && isOf(looked, frame)) {
        this.put(looked.key, "", toPane(view, looked.at), pane, () => make("div", { class: "marker looked", "data-testid": "looked-for" }, make("i", {})));
        seen.add(looked.key);
      }
    }
    for (const [key, { element }] of this.markers) {
      if (!seen.has(key)) { element.remove(); this.markers.delete(key); }
    }
  }

  private putPending(p: Pending, frame: FrameView, view: View, pane: Size): boolean {
    const size = { width: frame.width_px, height: frame.height_px };
    if (!isOf(p, frame) || !contains(size, p.at)) return false;
    const at = toPane(view, p.at);
    const look = `${p.category} ${p.number} ${p.isRefused}`;
    this.put(p.key, look, at, pane, () => (p.isRefused ? refusal() : marker(p.category, String(p.number), true, "")));
    if (p.isRefused) this.showBubble(p.text, at, pane);
    return true;
  }

  private redraw(): void {
    if (this.last !== null) this.draw(...this.last);
  }

  private put(key: string, look: string, at: Point, pane: Size, made: () => HTMLElement): void {
    let held = this.markers.get(key);
    if (held === undefined || held.look !== look) {
      held?.element.remove();
      held = { element: made(), look, x: NaN, y: NaN, isSeen: true };
      this.layer.append(held.element);
      this.markers.set(key, held);
    }
    // Only what has changed is written: two hundred markers stay as they are while one is added.
    if (held.x !== at.x || held.y !== at.y) {
      held.element.style.transform = `translate(${at.x}px, ${at.y}px)`;
      held.element.classList.toggle("below", at.y < BELOW_UNDER_PX);
      [held.x, held.y] = [at.x, at.y];
    }
    const isSeen = at.x >= 0 && at.y >= 0 && at.x <= pane.width && at.y <= pane.height;
    if (isSeen !== held.isSeen) { held.element.style.visibility = isSeen ? "visible" : "hidden"; held.isSeen = isSeen; }
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
export function pixelIn(pin: Pin, frame: FrameView): Pixel | null {
  for (const click of pin.clicks) {
    if (click.vehicle === frame.vehicle && click.session === frame.session && click.frame === frame.frame && click.u_px !== null && click.v_px !== null) {
      return { u: click.u_px, v: click.v_px };
    }
  }
  return pin.place.status === "ok" ? placeIn(frame, pin.place) : null;
}

function marker(category: Category, number: string, isMarked: boolean, flag: string): HTMLElement {
  const kind = kindOf(category);
  const element = make("div", { class: `marker${isMarked ? " marked" : ""}`, "data-testid": "picture-pin", "data-number": number });
  element.append(make("i", { class: "spot" }), shapeSvg(kind, 20, number));
  if (flag !== "") element.append(make("b", { class: "flag" }, flag));
  return element;
}

function isOf(spot: Spot, frame: FrameView): boolean {
  return spot.vehicle === frame.vehicle && spot.session === frame.session && spot.frame === frame.frame;
}

function refusal(): HTMLElement {
  return make("div", { class: "marker refused" }, make("i", { class: "cross" }, "×"));
}
