// The operator's own tiles as a source and layers. Vector tiles of any schema: areas, lines and points, without names.

import type { LayerSpecification, SourceSpecification } from "maplibre-gl";
import type { Tiles } from "./types.js";

const VECTOR_LAYERS = ["earth", "landcover", "landuse", "natural", "water", "waterway", "park", "boundaries", "boundary", "roads", "transportation", "transit", "buildings", "building"];
const WATER = /^water/, GREEN = /^(landcover|landuse|natural|park)$/, BUILT = /^building/, ROADS = /^(roads|transportation|transit)$/;

export function baseSource(tiles: Tiles): SourceSpecification {
  const isVector = tiles.format === "pbf";
  const common = tiles.attribution === "" ? {} : { attribution: plain(tiles.attribution) };
  if (tiles.kind === "pmtiles") {
    const url = `pmtiles://${new URL(tiles.url, location.href).href}`;
    return tiles.format === "pbf" ? { type: "vector", url, ...common } : { type: "raster", url, tileSize: 256, ...common };
  }
  const zoom = tiles.max_zoom > 0 ? { maxzoom: tiles.max_zoom } : {};
  const url = tiles.kind === "mbtiles" ? `${location.origin}${tiles.url}` : tiles.url;
  return isVector ? { type: "vector", tiles: [url], ...zoom, ...common } : { type: "raster", tiles: [url], tileSize: 256, ...zoom, ...common };
}

export function baseLayers(tiles: Tiles): LayerSpecification[] {
  if (tiles.format !== "pbf") return [{ id: "base", type: "raster", source: "base" }];
  return VECTOR_LAYERS.flatMap((name): LayerSpecification[] => {
    const fill = WATER.test(name) ? "#a9c7de" : GREEN.test(name) ? "#cfdcc4" : BUILT.test(name) ? "#c9bfb4" : "#e6e3dc";
    const line = WATER.test(name) ? "#7ba6c6" : ROADS.test(name) ? "#8b8f96" : "#b5b5b5";
    return [
      { id: `base-${name}-fill`, type: "fill", source: "base", "source-layer": name, filter: ["==", ["geometry-type"], "Polygon"], paint: { "fill-color": fill } },
      { id: `base-${name}-line`, type: "line", source: "base", "source-layer": name, filter: ["==", ["geometry-type"], "LineString"], paint: { "line-color": line, "line-width": ROADS.test(name) ? 1.5 : 1 } },
    ];
  });
}

/** An attribution as text: MapLibre would take markup for markup. */
function plain(text: string): string {
  return text.replace(/<[^>]*>/g, "").replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
}
