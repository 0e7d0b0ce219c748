// The picture pane: shows, zooms, and turns a press into a click with its own picture.

import { fitted, panned, resized, toPane, toPixel, contains, wholeView, zoomed, type Pixel, type Point, type Size, type View } from "./mapping.js";
import { paint } from "./paint.js";
import { byId } from "./dom.js";
import { TrackBoxes } from "./following.js";
import { SpotMarks } from "./found.js";
import { Markers } from "./markers.js";
import type { State } from "./state.js";
import type { Viewer, Loaded } from "./viewer.js";
import type { ClickBody } from "./types.js";
import type { Readout } from "./readout.js";

const STEP_PX = 10, FINE_PX = 1; // of the crosshair, on the screen
const SLACK_PX = 6; // a mouse that moves further than this drags
const HOLD_MS = 180; // a finger that stays this long gets a loupe, and aims until it is lifted
const LOUPE_ZOOM = 3;

interface Press { readonly id: number; readonly from: Point; readonly loaded: Loaded; aim: Pixel; isDrag: boolean; isAim: boolean; last: Point; readonly isTouch: boolean }

/** Where to the crosshair goes. */
const ARROWS: Record<string, Point> = { ArrowLeft: { x: -1, y: 0 }, ArrowRight: { x: 1, y: 0 }, ArrowUp: { x: 0, y: -1 }, ArrowDown: { x: 0, y: 1 } };

export class PicturePane {
  readonly element = byId("picture");
  private readonly stage = byId("stage");
  private readonly canvas = byId<HTMLCanvasElement>("canvas");
  private readonly loupe = byId<HTMLCanvasElement>("loupe");
  private readonly empty = byId("no-picture");
  readonly markers: Markers;
  private readonly boxes: TrackBoxes;
  private readonly marks: SpotMarks;
  private pane: Size = { width: 1, height: 1 };
  private picture: Size = { width: 640, height: 480 };
  private view: View = wholeView(this.picture, this.pane);
  private press: Press | null = null;
  private readonly fingers = new Map<number, Point>();
  private timer = 0;
  private isDue = false;
  private isPictureDue = false;
  private cross: Pixel | null = null;
  private readonly crosshair = byId("crosshair");

  constructor(
    private readonly state: State, private readonly viewer: Viewer, private readonly readout: Readout,
    private readonly onClick: (body: ClickBody) => void,
  ) {
    this.boxes = new TrackBoxes(byId("track-boxes"), state);
    this.marks = new SpotMarks(byId("track-boxes"), state);
    this.markers = new Markers(byId("markers"), state);
    new ResizeObserver(() => this.fit()).observe(this.stage);
    const e = this.element;
    e.addEventListener("pointerdown", (event) => this.down(event));
    e.addEventListener("pointermove", (event) => this.move(event));
    e.addEventListener("pointerup", (event) => this.up(event));
    e.addEventListener("pointercancel", (event) => this.cancel(event.pointerId));
    e.addEventListener("pointerleave", () => { state.hover(null); if (this.cross === null) readout.point(null); });
    e.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    e.addEventListener("contextmenu", (event) => event.preventDefault());
    state.on(["shown", "options"], () => this.invalidate());
    state.on(["pins", "hover", "selected", "tracks", "spots"], () => this.invalidate(false));
    state.on(["shown"], () => this.sized());
    this.fit();
  }

  zoom(factor: number): void {
    this.view = zoomed(this.view, factor, { x: this.pane.width / 2, y: this.pane.height / 2 }, this.picture, this.pane);
    this.invalidate();
  }

  whole(): void {
    this.view = wholeView(this.picture, this.pane);
    this.invalidate();
  }

  /** A press of a key, which may be for the crosshair; returns whether it was. */
  key(name: string, isFine: boolean): boolean {
    const loaded = this.viewer.loaded;
    if (loaded === null) return false;
    if (this.cross === null) {
      if (name !== "c" && !(name === "Enter" && document.activeElement === this.element)) return false;
      this.aimAt(toPixel(this.view, { x: this.pane.width / 2, y: this.pane.height / 2 }));
      return true;
    }
    const arrow = ARROWS[name];
    if (arrow !== undefined) {
      const by = isFine ? FINE_PX : STEP_PX, from = toPane(this.view, this.cross);
      const to = { x: Math.min(Math.max(from.x + by * arrow.x, 0), this.pane.width), y: Math.min(Math.max(from.y + by * arrow.y, 0), this.pane.height) };
      const at = toPixel(this.view, to);
      if (contains(this.picture, at)) this.aimAt(at);
    } else if (name === "Enter") this.onClick(this.body(loaded, this.cross));
    else if (name === "Escape" || name === "c") this.aimAt(null);
    else return false;
    return true;
  }

  private aimAt(at: Pixel | null): void {
    this.cross = at;
    this.drawCrosshair();
    this.pointAt(at);
  }

  private drawCrosshair(): void {
    this.crosshair.hidden = this.cross === null;
    if (this.cross === null) return;
    const p = toPane(this.view, this.cross);
    this.crosshair.style.transform = `translate(${p.x}px, ${p.y}px)`;
  }

  private body(loaded: Loaded, at: Pixel): ClickBody {
    const { vehicle, session, frame } = loaded.view;
    return { vehicle, session, frame, u: at.u, v: at.v };
  }

  /** Ask for the place of a pixel of what is shown. */
  private pointAt(at: Pixel | null): void {
    const loaded = this.press?.loaded ?? this.viewer.loaded;
    this.readout.point(at === null || loaded === null || !contains(this.picture, at) ? null : this.body(loaded, at));
  }

  /** Make sure a pixel is in view. */
  reveal(at: Pixel): void {
    const p = toPane(this.view, at);
    if (p.x < 0 || p.y < 0 || p.x > this.pane.width || p.y > this.pane.height) {
      this.view = panned(this.view, this.pane.width / 2 - p.x, this.pane.height / 2 - p.y, this.picture, this.pane);
    }
    this.invalidate();
  }

  private sized(): void {
    const loaded = this.viewer.loaded;
    this.empty.hidden = loaded !== null;
    if (loaded === null) return;
    const { width_px: width, height_px: height } = loaded.view;
    if (width !== this.picture.width || height !== this.picture.height) {
      this.picture = { width, height };
      this.fit();
      this.whole();
    }
  }

  /** The pane has the picture's shape and as much of the stage as that allows. */
  private fit(): void {
    const space = { width: this.stage.clientWidth, height: this.stage.clientHeight };
    if (space.width < 1 || space.height < 1) return;
    const size = fitted(this.picture, space);
    this.element.style.width = `${size.width}px`;
    this.element.style.height = `${size.height}px`;
    this.view = resized(this.view, this.picture, this.pane, size);
    this.pane = size;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(size.width * ratio);
    this.canvas.height = Math.round(size.height * ratio);
    this.draw();
  }

  /** Rendered with the next frame of the screen: the pins, and the picture too unless it is as it was. */
  private invalidate(isPicture = true): void {
    this.isPictureDue ||= isPicture;
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => { this.isDue = false; this.draw(this.isPictureDue); this.isPictureDue = false; });
  }

  private draw(isPicture = true): void {
    const loaded = this.press?.loaded ?? this.viewer.loaded;
    const ratio = window.devicePixelRatio || 1;
    if (Math.round(this.pane.width * ratio) !== this.canvas.width) { this.fit(); return; }
    if (loaded !== null && isPicture) paint(this.canvas, loaded, this.view, this.state.peeks);
    if (isPicture) this.element.dataset["zoom"] = (this.view.scale / wholeView(this.picture, this.pane).scale).toFixed(2);
    this.boxes.draw(loaded?.view ?? null, this.view, this.pane);
    this.marks.draw(loaded?.view ?? null, this.view);
    this.markers.draw(loaded?.view ?? null, this.view, this.pane);
    if (isPicture) { this.drawLoupe(); this.drawCrosshair(); }
    if (this.cross !== null && loaded !== null && isPicture) this.pointAt(this.cross);
  }

  private at(event: PointerEvent | WheelEvent): Point {
    const box = this.element.getBoundingClientRect();
    // The box's border is no part of the pane, and a zoomed page has another size than it reports.
    return { x: (event.clientX - box.left) * this.pane.width / box.width, y: (event.clientY - box.top) * this.pane.height / box.height };
  }

  private down(event: PointerEvent): void {
    if (event.pointerType === "mouse" && event.button !== 0) return;
    const at = this.at(event), loaded = this.viewer.loaded;
    this.fingers.set(event.pointerId, at);
    if (this.fingers.size > 1) { this.abandon(); return; }
    if (loaded === null) return;
    event.preventDefault();
    this.element.focus({ preventScroll: true });
    try { this.element.setPointerCapture(event.pointerId); } catch { /* the pointer is gone already */ }
    this.viewer.hold(this);
    const isTouch = event.pointerType !== "mouse";
    this.press = { id: event.pointerId, from: at, last: at, loaded, aim: toPixel(this.view, at), isDrag: false, isAim: false, isTouch };
    if (isTouch) this.timer = window.setTimeout(() => { this.startAim(); }, HOLD_MS);
  }

  private startAim(): void {
    if (this.press === null || this.press.isDrag) return;
    this.press.isAim = true;
    this.drawLoupe();
    this.pointAt(this.press.aim);
  }

  private move(event: PointerEvent): void {
    const at = this.at(event), press = this.press;
    const before = this.fingers.get(event.pointerId);
    if (this.fingers.size === 2 && before !== undefined) { this.pinch(event.pointerId, at); return; }
    if (before !== undefined) this.fingers.set(event.pointerId, at);
    if (press === null || press.id !== event.pointerId) {
      if (event.pointerType !== "mouse") return;
      const near = this.markers.near(at, false);
      this.state.hover(near);
      if (this.cross === null) this.pointAt(toPixel(this.view, at));
      return;
    }
    const isFar = Math.hypot(at.x - press.from.x, at.y - press.from.y) > SLACK_PX;
    if (press.isAim) {
      // A finger that was held aims: the loupe shows what is under it.
      press.aim = toPixel(this.view, at);
      press.last = at;
      this.drawLoupe();
      this.pointAt(press.aim);
      return;
    }
    // One that moves at once swipes: it moves a zoomed picture, and clicks nothing.
    if (isFar) press.isDrag = true;
    if (press.isDrag) {
      this.view = panned(this.view, at.x - press.last.x, at.y - press.last.y, this.picture, this.pane);
      this.invalidate();
    }
    press.last = at;
  }

  private up(event: PointerEvent): void {
    this.fingers.delete(event.pointerId);
    const press = this.press;
    if (press === null || press.id !== event.pointerId) return;
    // The pixel and the picture of the press: what came, grew or moved since does not change what was meant.
    const { aim, loaded, isDrag, isAim } = press;
    this.abandon();
    const size = { width: loaded.view.width_px, height: loaded.view.height_px };
    if (isDrag || !contains(size, aim)) return;
    // On a pin that is shown there a click chooses it; aimed with the loupe, or with the Shift key, it makes another.
    const known = this.state.mode.kind === "pin" && !isAim && !event.shiftKey ? this.markers.near(press.from, press.isTouch) : null;
    if (known !== null) this.state.select(known);
    else this.onClick(this.body(loaded, aim));
  }

  private cancel(id: number): void {
    this.fingers.delete(id);
    if (this.press?.id === id) this.abandon();
  }

  private abandon(): void {
    window.clearTimeout(this.timer);
    this.press = null;
    this.loupe.hidden = true;
    if (this.cross === null) this.readout.point(null);
    this.viewer.release(this);
  }

  private pinch(id: number, at: Point): void {
    const [a, b] = [...this.fingers.values()];
    this.fingers.set(id, at);
    const [c, d] = [...this.fingers.values()];
    if (a === undefined || b === undefined || c === undefined || d === undefined) return;
    const was = Math.hypot(a.x - b.x, a.y - b.y), is = Math.hypot(c.x - d.x, c.y - d.y);
    const from = { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 }, to = { x: (c.x + d.x) / 2, y: (c.y + d.y) / 2 };
    this.view = zoomed(this.view, is / Math.max(was, 1), from, this.picture, this.pane, to);
    this.invalidate();
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 24 : 1;
    this.view = zoomed(this.view, Math.exp(-event.deltaY * lines * 0.0015), this.at(event), this.picture, this.pane);
    this.invalidate();
  }

  /** What is under the finger, larger and next to it. */
  private drawLoupe(): void {
    const press = this.press;
    this.loupe.hidden = press === null || !press.isAim;
    if (press === null || !press.isAim) return;
    const ratio = window.devicePixelRatio || 1;
    const side = this.loupe.clientWidth || 140;
    this.loupe.width = this.loupe.height = Math.round(side * ratio);
    const scale = this.view.scale * LOUPE_ZOOM;
    const view = { scale, left: side / 2 - (press.aim.u + 0.5) * scale, top: side / 2 - (press.aim.v + 0.5) * scale };
    paint(this.loupe, press.loaded, view, this.state.peeks);
    const context = this.loupe.getContext("2d");
    if (context !== null) {
      for (const [colour, width] of [["#000", 3], ["#fff", 1]] as const) {
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.beginPath();
        context.moveTo(side / 2, side / 2 - 22); context.lineTo(side / 2, side / 2 - 5);
        context.moveTo(side / 2, side / 2 + 5); context.lineTo(side / 2, side / 2 + 22);
        context.moveTo(side / 2 - 22, side / 2); context.lineTo(side / 2 - 5, side / 2);
        context.moveTo(side / 2 + 5, side / 2); context.lineTo(side / 2 + 22, side / 2);
        context.stroke();
      }
    }
    const p = toPane(this.view, press.aim);
    const above = p.y - side - 40;
    this.loupe.style.transform = `translate(${Math.min(Math.max(p.x - side / 2, 0), this.pane.width - side)}px, ${above >= 0 ? above : p.y + 50}px)`;
  }
}
