// Which of a machine's finds are new to this page: each alarms once. Pure: no DOM.

import type { FoundSpot } from "./types.js";

/**
 * Those that are new, which then are known: by number the time at which each was first seen. A server that was begun
 * again counts from one: what was first seen later than the find known by that number is another, and alarms too.
 */
export function newFinds(known: Map<number, string>, spots: readonly FoundSpot[]): FoundSpot[] {
  const news = spots.filter((spot) => spot.first_utc > (known.get(spot.spot) ?? ""));
  for (const spot of spots) known.set(spot.spot, spot.first_utc);
  return news;
}
