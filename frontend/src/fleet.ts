// Of many aircraft: which tiles are shown, and in which group. Those with trouble come first.

import type { VehicleState } from "./types.js";

export const MANY = 12; // above which there are groups, and a field to find one

export type Group = VehicleState["state"];
export const GROUPS: readonly Group[] = ["lost", "warning", "well"];
const TITLES: Record<Group, string> = { lost: "lost", warning: "with a warning", well: "well" };

/** How many of a group there are, in words, and how many of them are shown if not all. */
export function groupTitle(group: Group, vehicles: readonly VehicleState[], text: string): string {
  const all = vehicles.filter((one) => one.state === group), shown = all.filter((one) => isWanted(one, text)).length;
  if (all.length === 0) return "";
  return `${shown < all.length ? `${shown} of ` : ""}${all.length} ${TITLES[group]}`;
}

/** Whether what was typed is in an aircraft's name, state or trouble; every word of it, in small or capital letters. */
export function isWanted(one: VehicleState, text: string): boolean {
  const words = `${one.id} ${one.state} ${one.words} ${one.trouble}`.toLowerCase();
  return text.toLowerCase().split(/\s+/).every((word) => words.includes(word));
}
