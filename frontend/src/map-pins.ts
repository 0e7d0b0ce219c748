// What the map has of each pin: its spot, its shape, its name, its ellipse.

import { ellipseRing } from "./projection.js";
import { kindOf } from "./shapes.js";
import type { Pin, PlaceAnswer } from "./types.js";

export type Feature = { type: "Feature"; id?: number; geometry: { type: string; coordinates: unknown }; properties: Record<string, unknown> };

const NAME_LENGTH = 20; // of a longer name the rest is in the list

/** One place, or each of those that contradict each other. */
export interface MapPin { readonly pin: Pin; readonly isMarked: boolean; readonly keys: string[]; readonly pins: Feature[]; readonly ellipses: Feature[] }

export function mapPin(pin: Pin, isMarked: boolean): MapPin {
  const pins: Feature[] = [], ellipses: Feature[] = [];
  placesOf(pin).forEach((place, k) => {
    const key = keyOf(pin, k), colour = kindOf(pin.category).colour;
    pins.push({
      type: "Feature", geometry: { type: "Point", coordinates: [place.lon_deg, place.lat_deg] },
      properties: {
        key, id: pin.id, colour, icon: `${pin.category}${isMarked ? "-marked" : ""}`,
        label: `${pin.number}${pin.place.status === "ok" ? "" : "!"}`, name: shortened(pin.name), order: isMarked ? 1e9 : pin.number,
      },
    });
    const e = place.ellipse;
    if (e !== null) {
      const ring = ellipseRing(place.lat_deg, place.lon_deg, e.semi_major_m, e.semi_minor_m, e.azimuth_deg);
      ellipses.push({ type: "Feature", geometry: { type: "Polygon", coordinates: [ring] }, properties: { key, colour } });
    }
  });
  return { pin, isMarked, keys: pins.map((feature) => String(feature.properties["key"])), pins, ellipses };
}

/** A feature's name. MapLibre reads a number off its beginning, and one above 2^64 takes the whole tile away: so a letter first. */
function keyOf(pin: Pin, k: number): string { return `p${pin.id}/${k}`; }

/** A pin of very many: where it is, and no more. */
export function dotsOf(pin: Pin): Feature[] {
  return placesOf(pin).map((place, k) => ({
    type: "Feature", geometry: { type: "Point", coordinates: [place.lon_deg, place.lat_deg] },
    properties: { key: keyOf(pin, k), id: pin.id, colour: kindOf(pin.category).colour },
  }));
}

export function placesOf(pin: Pin): PlaceAnswer[] {
  return pin.place.status === "ok" ? [pin.place] : pin.place.status === "contradiction" ? pin.place.answers : [];
}

function shortened(name: string): string {
  return name.length <= NAME_LENGTH ? name : `${name.slice(0, NAME_LENGTH - 1)}…`;
}
