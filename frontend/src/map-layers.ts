// The layers of the map, from bottom to top, and their look.

import type { GeoJSONSource, Map as MapLibreMap, StyleSpecification } from "maplibre-gl";
import type { BaseMap } from "./base-map.js";
import type { Feature } from "./map-pins.js";
import { KINDS } from "./shapes.js";

export const ABOVE_PICTURES = "footprint-fill"; // the lowest layer above the pictures
export const PIN_LAYERS = ["dots", "spots", "pins"];
const ICON = 20, LIFT = 6; // px: a pin's shape, and how far it stands above its spot, so that it hides no ellipse
const SOURCES = ["grid", "path", "footprint", "features", "ellipses", "dots", "pins", "ties", "craft", "track-areas", "track-lines", "track-labels"] as const;
export type SourceName = (typeof SOURCES)[number];

interface Palette { ground: string; grid: string; major: string; text: string; halo: string }
const PALETTES: Record<"day" | "night", Palette> = {
  day: { ground: "#eef1f4", grid: "#d3dae2", major: "#aab6c4", text: "#1b2530", halo: "#ffffff" },
  night: { ground: "#10161d", grid: "#202c38", major: "#36475a", text: "#e6edf3", halo: "#000000" },
};

export function emptyStyle(base: BaseMap | null): StyleSpecification {
  const style: StyleSpecification = { version: 8, sources: {}, layers: [{ id: "background", type: "background", paint: { "background-color": "#eef1f4" } }] };
  if (base !== null) {
    style.sources["base"] = base.source;
    style.layers.push(...base.layers);
  }
  return style;
}

export function collection(features: Feature[]): Parameters<GeoJSONSource["setData"]>[0] {
  return { type: "FeatureCollection", features } as unknown as Parameters<GeoJSONSource["setData"]>[0];
}

export function addLayers(map: MapLibreMap, base: BaseMap | null): void {
  for (const name of SOURCES) map.addSource(name, { type: "geojson", data: collection([]), promoteId: "key" });
  for (const kind of KINDS) for (const isMarked of [false, true]) {
    map.addImage(`${kind.word}${isMarked ? "-marked" : ""}`, icon(kind.path, kind.colour, isMarked), { pixelRatio: 2 });
  }
  map.addImage("tie", icon("M12 1v22M1 12h22", "#111", false, true), { pixelRatio: 2 });
  // Under the tiles: it is seen where there are none.
  map.addLayer({ id: "grid", type: "line", source: "grid", paint: { "line-width": 1 } }, base?.layers[0]?.id);
  map.addLayer({ id: "footprint-fill", type: "fill", source: "footprint", paint: { "fill-color": ["get", "colour"], "fill-opacity": 0.06 } });
  map.addLayer({ id: "footprint", type: "line", source: "footprint", paint: { "line-color": ["get", "colour"], "line-width": 2 } });
  const strong = ["case", ["get", "chosen"], 1, 0.55] as never;
  map.addLayer({ id: "path", type: "line", source: "path", layout: { "line-sort-key": ["case", ["get", "chosen"], 1, 0] }, paint: { "line-color": ["get", "colour"], "line-width": ["case", ["get", "chosen"], 2.5, 1.5], "line-opacity": strong, "line-dasharray": [2, 1.5] } });
  map.addLayer({ id: "features", type: "circle", source: "features", paint: { "circle-radius": 2.5, "circle-color": "#7dd3fc", "circle-stroke-color": "#0b2545", "circle-stroke-width": 1 } });
  map.addLayer({ id: "track-areas", type: "fill", source: "track-areas", paint: { "fill-color": ["get", "colour"], "fill-opacity": ["match", ["get", "kind"], "band", 0.12, 0.22] } });
  map.addLayer({ id: "track-under", type: "line", source: "track-lines", layout: { "line-cap": "round" }, paint: { "line-color": "#ffffff", "line-width": 5, "line-opacity": 0.8 } });
  map.addLayer({ id: "track-lines", type: "line", source: "track-lines", filter: ["!=", ["get", "kind"], "guessed"], layout: { "line-cap": "round" }, paint: { "line-color": ["get", "colour"], "line-width": ["match", ["get", "kind"], "arrow", 3, 2] } });
  map.addLayer({ id: "track-guessed", type: "line", source: "track-lines", filter: ["==", ["get", "kind"], "guessed"], paint: { "line-color": ["get", "colour"], "line-width": 2.5, "line-dasharray": [1.5, 1.5] } });
  map.addLayer({ id: "ellipse-fill", type: "fill", source: "ellipses", paint: { "fill-color": ["get", "colour"], "fill-opacity": 0.16 } });
  // A pale edge outside the coloured one: it is visible on any picture.
  map.addLayer({ id: "ellipse-edge", type: "line", source: "ellipses", paint: { "line-color": "#ffffff", "line-width": 4, "line-opacity": 0.85 } });
  map.addLayer({ id: "ellipse", type: "line", source: "ellipses", paint: { "line-color": ["get", "colour"], "line-width": 2 } });
  map.addLayer({ id: "craft", type: "circle", source: "craft", layout: { "circle-sort-key": ["case", ["get", "chosen"], 1, 0] }, paint: { "circle-radius": ["case", ["get", "chosen"], 7, 5], "circle-color": ["get", "colour"], "circle-opacity": strong, "circle-stroke-color": "#fff", "circle-stroke-width": 2 } });
  map.addLayer({ id: "ties", type: "symbol", source: "ties", layout: { "icon-image": "tie", "icon-allow-overlap": true } });
  map.addLayer({ id: "dots", type: "circle", source: "dots", paint: { "circle-radius": 3, "circle-color": ["get", "colour"], "circle-stroke-color": "#fff", "circle-stroke-width": 0.5 } });
  // Placed after the pins, from top to bottom: a name is left out where it would cover a pin.
  map.addLayer({
    id: "craft-names", type: "symbol", source: "craft",
    layout: { "text-field": ["get", "name"], "text-font": ["sans-serif"], "text-size": 12, "text-offset": [0, 0.8], "text-anchor": "top", "text-optional": true },
    paint: { "text-halo-width": 1.5 },
  });
  map.addLayer({
    id: "names", type: "symbol", source: "pins", filter: ["!=", ["get", "name"], ""],
    layout: { "symbol-sort-key": ["*", -1, ["get", "order"]], "text-field": ["get", "name"], "text-font": ["sans-serif"], "text-size": 12, "text-max-width": 30, "text-variable-anchor": ["top", "top-right", "top-left", "left", "right"], "text-radial-offset": 0.7, "text-justify": "auto", "text-optional": true },
    paint: { "text-halo-width": 1.5 },
  });
  map.addLayer({
    id: "track-labels", type: "symbol", source: "track-labels",
    layout: { "text-field": ["get", "text"], "text-font": ["sans-serif"], "text-size": 12, "text-max-width": 18, "text-anchor": "top-left", "text-offset": [0.9, 0.4], "text-justify": "left", "text-allow-overlap": true },
    paint: { "text-halo-width": 1.5 },
  });
  map.addLayer({ id: "spots", type: "circle", source: "pins", paint: { "circle-radius": 3, "circle-opacity": 0, "circle-stroke-color": ["get", "colour"], "circle-stroke-width": 2 } });
  map.addLayer({
    id: "pins", type: "symbol", source: "pins",
    layout: {
      "icon-image": ["get", "icon"], "icon-anchor": "bottom", "icon-offset": [0, -LIFT], "icon-allow-overlap": true, "symbol-sort-key": ["get", "order"],
      "text-field": ["get", "label"], "text-font": ["sans-serif"], "text-size": 10, "text-offset": [0, -(LIFT + ICON / 2) / 10], "text-allow-overlap": true,
    },
    paint: { "text-color": "#ffffff" },
  });
}

export function paintTheme(map: MapLibreMap, theme: "day" | "night"): void {
  const p = PALETTES[theme];
  map.setPaintProperty("background", "background-color", p.ground);
  map.setPaintProperty("grid", "line-color", ["case", ["get", "major"], p.major, p.grid]);
  for (const name of ["names", "craft-names", "track-labels"]) {
    map.setPaintProperty(name, "text-color", p.text);
    map.setPaintProperty(name, "text-halo-color", p.halo);
  }
}

function icon(path: string, colour: string, isMarked: boolean, isLine = false): ImageData {
  const side = (isMarked ? 1.3 : 1) * ICON * 2;
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = Math.round(side);
  const context = canvas.getContext("2d")!;
  context.scale(canvas.width / 28, canvas.height / 28);
  context.translate(2, 2);
  const shape = new Path2D(path);
  context.lineJoin = "round";
  context.strokeStyle = isMarked ? "#000" : "#fff";
  context.lineWidth = isMarked || isLine ? 4 : 2.5;
  context.stroke(shape);
  if (isLine) {
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.stroke(shape);
  } else {
    if (isMarked) { context.strokeStyle = "#fff"; context.lineWidth = 2; context.stroke(shape); }
    context.fillStyle = colour;
    context.fill(shape);
  }
  return context.getImageData(0, 0, canvas.width, canvas.height);
}
