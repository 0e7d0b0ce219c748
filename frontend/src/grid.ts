// A metre grid about an origin, in steps of 1, 2, 5 times ten, as lines for the map. Pure.

import { offset } from "./projection.js";

const RAD = Math.PI / 180.0;
const METRES_A_DEGREE = 111_320.0;

export interface GridLine { readonly metres: number; readonly isMajor: boolean; readonly ends: [[number, number], [number, number]] }

/** A step so that some ten lines cross a span. */
export function gridStep(spanM: number): number {
  const rough = Math.max(spanM, 1e-3) / 10.0;
  const ten = 10 ** Math.floor(Math.log10(rough));
  return ([1, 2, 5, 10].find((n) => n * ten >= rough) ?? 10) * ten;
}

/** Lines that cover a view, every fifth a major one. Bounds are west, south, east, north in degrees. */
export function gridLines(origin: { lat: number; lon: number }, bounds: [number, number, number, number]): { step: number; lines: GridLine[] } {
  const [west, south, east, north] = bounds;
  const alongEast = METRES_A_DEGREE * Math.cos(origin.lat * RAD);
  const span = [
    [(west - origin.lon) * alongEast, (east - origin.lon) * alongEast],
    [(south - origin.lat) * METRES_A_DEGREE, (north - origin.lat) * METRES_A_DEGREE],
  ] as const;
  const step = gridStep(Math.max(span[0][1] - span[0][0], span[1][1] - span[1][0]));
  const lines: GridLine[] = [];
  for (const axis of [0, 1] as const) {
    const [from, to] = span[axis], [low, high] = span[1 - axis] as readonly [number, number];
    for (let k = Math.floor(from / step); k <= Math.ceil(to / step) && lines.length < 200; k++) {
      const at = (other: number): [number, number] =>
        axis === 0 ? offset(origin.lat, origin.lon, k * step, other) : offset(origin.lat, origin.lon, other, k * step);
      lines.push({ metres: k * step, isMajor: k % 5 === 0, ends: [at(low), at(high)] });
    }
  }
  return { step, lines };
}
