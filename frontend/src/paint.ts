// Draws a picture and what belongs to it on a canvas.

import { toPane, type View } from "./mapping.js";
import type { Peek } from "./state.js";
import type { Loaded } from "./viewer.js";

export type Layers = ReadonlyMap<Peek, unknown>;

const TRACKED = "#7dd3fc", NEW = "#fde047", EDGE = "rgba(0,0,0,0.75)", PATH = "rgba(125,211,252,0.6)";

export function paint(canvas: HTMLCanvasElement, loaded: Loaded, view: View, layers: Layers): void {
  const context = canvas.getContext("2d", { alpha: false });
  if (context === null) return;
  const ratio = window.devicePixelRatio || 1;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const width = canvas.width / ratio, height = canvas.height / ratio;
  context.fillStyle = "#10151c";
  context.fillRect(0, 0, width, height);
  const { view: frame, image } = loaded;
  const w = frame.width_px * view.scale, h = frame.height_px * view.scale;
  if (image !== null) {
    context.imageSmoothingEnabled = view.scale < 4;
    context.drawImage(image, view.left, view.top, w, h);
  } else {
    constellation(context, loaded, view, w, h);
  }
  if (layers.has("paths") || image === null) paths(context, loaded, view);
  if (layers.has("features") || image === null) features(context, loaded, view, image === null);
}

/** Without a picture: the camera's field of view with a grid, so that the user can click among the features. */
function constellation(context: CanvasRenderingContext2D, loaded: Loaded, view: View, w: number, h: number): void {
  context.fillStyle = "#17222e";
  context.fillRect(view.left, view.top, w, h);
  context.strokeStyle = "#2b3d4f";
  context.lineWidth = 1;
  context.beginPath();
  const step = Math.max(loaded.view.width_px / 8, 1) * view.scale;
  for (let x = view.left + step; x < view.left + w - 1; x += step) { context.moveTo(x, view.top); context.lineTo(x, view.top + h); }
  for (let y = view.top + step; y < view.top + h - 1; y += step) { context.moveTo(view.left, y); context.lineTo(view.left + w, y); }
  context.stroke();
}

function paths(context: CanvasRenderingContext2D, loaded: Loaded, view: View): void {
  const { uv, paths: all } = loaded.view.features;
  context.strokeStyle = PATH;
  context.lineWidth = 1.25;
  context.beginPath();
  uv.forEach(([u, v], k) => {
    const path = all[k];
    if (path === undefined || path.length === 0) return;
    const start = toPane(view, { u, v });
    context.moveTo(start.x, start.y);
    for (const [pu, pv] of path) {
      const at = toPane(view, { u: pu, v: pv });
      context.lineTo(at.x, at.y);
    }
  });
  context.stroke();
}

/** Tracked ones round, new ones square: by shape too. */
function features(context: CanvasRenderingContext2D, loaded: Loaded, view: View, isLarge: boolean): void {
  const { uv, paths: all } = loaded.view.features;
  const size = isLarge ? 4.5 : 3;
  for (const isNew of [false, true]) {
    context.beginPath();
    uv.forEach(([u, v], k) => {
      if (((all[k]?.length ?? 0) === 0) !== isNew) return;
      const { x, y } = toPane(view, { u, v });
      if (isNew) {
        context.rect(x - size, y - size, 2 * size, 2 * size);
      } else {
        context.moveTo(x + size, y);
        context.arc(x, y, size, 0, 2 * Math.PI);
      }
    });
    context.lineWidth = 3;
    context.strokeStyle = EDGE;
    context.stroke();
    context.lineWidth = 1.5;
    context.strokeStyle = isNew ? NEW : TRACKED;
    context.stroke();
  }
}
