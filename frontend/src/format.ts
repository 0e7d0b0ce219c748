// Numbers and times as people read them.

import type { How } from "./types.js";

// As ground/formats/rounded.py: rounding moves a place by at most this share of its 90 % radius.
const SHARE = 0.2, UNKNOWN_M = 5, METRES_A_DEGREE = 111_700, MOST_DECIMALS = 7;

/** Latitude and longitude to as many digits as the 90 % radius gives meaning to. */
export function degrees(lat: number, lon: number, ce90: number | null): string {
  const places = decimals(ce90);
  return `${lat.toFixed(places)}, ${lon.toFixed(places)}`;
}

export function decimals(ce90: number | null): number {
  const allowed = SHARE * (ce90 ?? UNKNOWN_M);
  let places = 0;
  while (places < MOST_DECIMALS && Math.SQRT1_2 * METRES_A_DEGREE * 10 ** -places > allowed) places += 1;
  return places;
}

/** How sure a place is, in words. */
export function within(ce90: number | null): string {
  return ce90 === null ? "accuracy unknown" : `90 % within ${radius(ce90)}`;
}

/** With a capital letter. */
export function sentence(text: string): string {
  return `${text.charAt(0).toUpperCase()}${text.slice(1)}`;
}

export const WITHIN_TITLE = "with 90 % certainty the place lies within this radius (CE90)";

/** Height of a place, in words; with how sure it is, if that is wanted. */
export function heightText(place: { height_amsl_m: number | null; height_ellipsoid_m: number | null; le90_m: number | null }): string {
  const height = place.height_amsl_m ?? place.height_ellipsoid_m;
  if (height === null) return "height unknown";
  const digits = place.le90_m !== null && place.le90_m < 2 ? 1 : 0;
  return `${height.toFixed(digits)} m above ${place.height_amsl_m !== null ? "sea level" : "the ellipsoid"}`;
}

/** How a place came about: in a few words, and what they mean. */
export function methodWords(how: How | undefined): [string, string] {
  const [words, meaning] = meant(how);
  return how === undefined || how.unmeasured === "" ? [words, meaning] : [words, `${meaning}; not measured by itself: ${how.unmeasured}`];
}

/** Height above the ground around it; one sigma. */
function aboveText(metres: number, sigma: number): string {
  return `${Math.abs(metres).toFixed(1)} ± ${sigma.toFixed(1)} m ${metres < 0 ? "below" : "above"} the ground`;
}

function meant(how: How | undefined): [string, string] {
  const method = how?.method ?? "";
  switch (method) {
    case "measured": return [
      how!.above_ground_m === null ? "measured" : `measured, ${aboveText(how!.above_ground_m, how!.sigma_above_ground_m ?? 0)}`,
      "the clicked spot itself was found in other pictures; the height is that above the ground around it, ± one sigma"];
    case "interpolated": return ["between measured points", "on the ground between points that were measured from several pictures"];
    case "plane": return ["beyond what was measured", "on the ground plane through the measured points, outside of them"];
    case "terrain": return ["from terrain", "where the line of sight meets the terrain model"];
    case "entered": return ["typed", "a coordinate that was typed or imported"];
    default: return [method, ""];
  }
}

/** A grid's step: 0.5 m, 200 m, 1 km. */
export function stepText(metres: number): string {
  return metres < 1000 ? `${Number(metres.toPrecision(3))} m` : `${Number((metres / 1000).toPrecision(3))} km`;
}

/** "3.2 m", "12 m", "1.4 km": rounded up, because a radius may be stated larger than it is, never smaller. */
export function radius(metres: number | null): string {
  if (metres === null) return "unknown";
  if (metres < 10) return `${(Math.ceil(metres * 10 - 1e-9) / 10).toFixed(1)} m`;
  if (metres < 1000) return `${Math.ceil(metres - 1e-9)} m`;
  return `${(Math.ceil(metres / 100) / 10).toFixed(1)} km`;
}

export function distance(metres: number): string {
  return metres < 1000 ? `${metres.toFixed(1)} m` : `${(metres / 1000).toFixed(3)} km`;
}

export function age(seconds: number | null): string {
  if (seconds === null) return "age unknown";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${seconds.toFixed(0)} s`;
  return seconds < 7200 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(1)} h`;
}

/** Time of day in UTC of Unix nanoseconds as a string. */
export function clock(unixNs: string): string {
  const ms = Number(BigInt(unixNs) / 1_000_000n);
  return `${new Date(ms).toISOString().slice(11, 21)} UTC`;
}

/** Day and time in UTC of an ISO moment, to the second. */
export function moment(iso: string): string {
  return `${iso.slice(0, 19).replace("T", " ")} UTC`;
}
