// The operator's own tiles as a source and layers. Vector tiles of any schema: areas, lines and points, without names.

import type { LayerSpecification, SourceSpecification } from "maplibre-gl";
import { PMTiles } from "pmtiles";
import type { Tiles } from "./types.js";

export type Bounds = [number, number, number, number];

/** `bounds` and `minZoom`: where there are tiles, as far as that is known. */
export interface BaseMap { source: SourceSpecification; layers: LayerSpecification[]; bounds: Bounds | null; minZoom: number; archive: PMTiles | null }

const VECTOR_LAYERS = ["earth", "landcover", "landuse", "natural", "water", "waterway", "park", "boundaries", "boundary", "roads", "transportation", "transit", "buildings", "building"];
const WATER = /^water/, GREEN = /^(landcover|landuse|natural|park)$/, BUILT = /^building/, ROADS = /^(roads|transportation|transit)$/;
const MVT = 1;

/** Reads the description at a URL. Throws where it cannot be read. */
export async function baseMap(tiles: Tiles): Promise<BaseMap> {
  const common = tiles.attribution === "" ? {} : { attribution: plain(tiles.attribution) };
  if (tiles.kind === "pmtiles") {
    const url = new URL(tiles.url, location.href).href, archive = new PMTiles(url);
    const header = await archive.getHeader();
    return made({ url: `pmtiles://${url}`, ...common }, header.tileType === MVT, known([header.minLon, header.minLat, header.maxLon, header.maxLat]), header.minZoom, archive);
  }
  if (tiles.kind === "tilejson") {
    const answer = await fetch(tiles.url);
    if (!answer.ok) throw new Error(`${tiles.url}: ${answer.status}`);
    const about = await answer.json() as { tiles: string[]; minzoom?: number; maxzoom?: number; bounds?: Bounds; attribution?: string; scheme?: string; vector_layers?: unknown };
    const zooms = { minzoom: about.minzoom ?? 0, ...(about.maxzoom === undefined ? {} : { maxzoom: about.maxzoom }) };
    const bounds = about.bounds === undefined ? null : known(about.bounds);
    const source = { tiles: about.tiles, ...(about.scheme === "tms" ? { scheme: "tms" } : {}), ...zooms, ...(bounds === null ? {} : { bounds }), ...(about.attribution === undefined ? {} : { attribution: plain(about.attribution) }), ...common };
    return made(source, about.vector_layers !== undefined, bounds, zooms.minzoom, null);
  }
  // What was downloaded of an address: the map begins there, and the server sends on to the address for the rest.
  const zooms = { ...(tiles.max_zoom > 0 ? { maxzoom: tiles.max_zoom } : {}), minzoom: tiles.min_zoom, ...(tiles.bounds === null || tiles.kind === "kept" ? {} : { bounds: tiles.bounds }) };
  const url = tiles.kind === "mbtiles" || tiles.kind === "kept" ? `${location.origin}${tiles.url}` : tiles.url;
  // The map's own zooms count tiles of 512 pixels, images have 256.
  const isVector = tiles.format === "pbf", first = tiles.kept_from === undefined ? tiles.min_zoom : tiles.kept_from - (isVector ? 0 : 1);
  return made({ tiles: [url], ...zooms, ...common }, isVector, tiles.bounds, first, null);
}

function made(source: object, isVector: boolean, bounds: Bounds | null, minZoom: number, archive: PMTiles | null): BaseMap {
  const full = (isVector ? { type: "vector", ...source } : { type: "raster", tileSize: 256, ...source }) as SourceSpecification;
  return { source: full, layers: isVector ? vectorLayers() : [{ id: "base", type: "raster", source: "base" }], bounds, minZoom, archive };
}

/** Bounds that are usable; some writers leave them empty. */
function known(bounds: Bounds): Bounds | null {
  const [west, south, east, north] = bounds;
  return west < east && south < north ? [west, Math.max(south, -85), east, Math.min(north, 85)] : null;
}

function vectorLayers(): LayerSpecification[] {
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
