// What the map has of each thing that is followed: its path with the band that it lies in, its ellipse, its course. Pure.

import type { Feature } from "./map-pins.js";
import { ellipseRing, offset } from "./projection.js";
import type { Phase, TrackNow } from "./tracks.js";
import { stateWords } from "./tracks.js";
import type { FoundSpot, TrackPlace } from "./types.js";

const AHEAD_S = 5; // the arrow is as long as what it does in this time
const LEAST_ARROW_M = 2;
const SIGMAS = 1.645; // of a course: between the sides of the wedge it lies with 90 %
const LEAST_STEP_M = 4; // shorter steps have no direction that a band could be across
const METRES_A_DEGREE = 111_320, RAD = Math.PI / 180;
export const PHASE_COLOURS: Record<Phase, string> = { followed: "#b5179e", coasting: "#9a5b00", lost: "#4a5866", ended: "#4a5866" };

export interface TrackFeatures { readonly areas: Feature[]; readonly lines: Feature[]; readonly labels: Feature[] }

export function trackFeatures(tracks: readonly TrackNow[]): TrackFeatures {
  const areas: Feature[] = [], lines: Feature[] = [], labels: Feature[] = [];
  for (const track of tracks) {
    const places = track.path.flatMap((report) => (report.place === null ? [] : [report.place]));
    if (track.last.place !== null && track.last.place !== places.at(-1)) places.push(track.last.place); // where it may be by now
    const last = places.at(-1);
    if (last === undefined) continue;
    const colour = PHASE_COLOURS[track.phase], isNow = track.phase === "followed" || track.phase === "coasting";
    const area = (ring: [number, number][], kind: string): void => { areas.push({ type: "Feature", geometry: { type: "Polygon", coordinates: [ring] }, properties: { colour, kind } }); };
    const line = (ends: [number, number][], kind: string): void => { lines.push({ type: "Feature", geometry: { type: "LineString", coordinates: ends }, properties: { colour, kind, track: track.key } }); };
    const band = bandOf(places);
    if (band !== null) area(band, "band");
    if (places.length > 1) line(places.map((place) => [place.lon_deg, place.lat_deg]), track.phase === "coasting" ? "guessed" : "path");
    const ring = ellipseRing(last.lat_deg, last.lon_deg, last.semi_major_m, last.semi_minor_m, last.azimuth_deg);
    area(ring, "ellipse");
    line(ring, "edge");
    const course = track.last.course;
    if (isNow && track.last.place !== null && course !== null && course.course_deg !== null && course.sigma_course_deg !== null) {
      const far = Math.max(course.speed_m_s * AHEAD_S, LEAST_ARROW_M);
      line(arrow(last, course.course_deg, far), "arrow");
      area(wedge(last, course.course_deg, Math.min(SIGMAS * course.sigma_course_deg, 180), far), "wedge");
    }
    labels.push({ type: "Feature", geometry: { type: "Point", coordinates: [last.lon_deg, last.lat_deg] }, properties: { colour, text: `${track.number} ${track.phase === "followed" ? track.last.words : stateWords(track)}`, id: track.key } });
  }
  return { areas, lines, labels };
}

export const SPOT_COLOUR = "#d1004b"; // of a machine's find: no kind of pin has it

/** What a machine found and no person has decided on: its ellipse, and how hot it is. */
export function spotFeatures(spots: readonly FoundSpot[]): TrackFeatures {
  const areas: Feature[] = [], lines: Feature[] = [], labels: Feature[] = [];
  for (const spot of spots) {
    const e = spot.ellipse, ring = ellipseRing(spot.lat_deg, spot.lon_deg, e.semi_major_m, e.semi_minor_m, e.azimuth_deg);
    const properties = { colour: SPOT_COLOUR, track: `spot ${spot.spot}` };
    areas.push({ type: "Feature", geometry: { type: "Polygon", coordinates: [ring] }, properties: { ...properties, kind: "ellipse" } });
    lines.push({ type: "Feature", geometry: { type: "LineString", coordinates: ring }, properties: { ...properties, kind: "edge" } });
    labels.push({ type: "Feature", geometry: { type: "Point", coordinates: [spot.lon_deg, spot.lat_deg] }, properties: { ...properties, text: `♨ ${spot.spot} ${shortFind(spot)}` } });
  }
  return { areas, lines, labels };
}

/** What a net takes it for and how likely, else how hot: in few words. */
export function shortFind(spot: FoundSpot): string {
  if (spot.kind !== null && spot.probability !== null) return `${spot.kind} ${Math.round(100 * spot.probability)} %`;
  return spot.temperature_c === null ? `${spot.contrast.toFixed(0)} σ` : `${spot.temperature_c.toFixed(1)} °C`;
}

/** The places of a path widened on both sides by what their ellipses reach across it; null for one that has no way. */
export function bandOf(places: readonly TrackPlace[]): [number, number][] | null {
  const left: [number, number][] = [], right: [number, number][] = [];
  let at = places[0];
  for (const place of places) {
    if (at === undefined) break;
    const north = (place.lat_deg - at.lat_deg) * METRES_A_DEGREE, east = (place.lon_deg - at.lon_deg) * METRES_A_DEGREE * Math.cos(at.lat_deg * RAD);
    const far = Math.hypot(east, north), reach = Math.max(LEAST_STEP_M, 0.5 * place.semi_major_m);
    if (far < reach) continue;
    const [x, y] = [-north / far, east / far]; // to the left of the way
    for (const one of left.length === 0 ? [at, place] : [place]) {
      const half = acrossM(one, x, y);
      left.push(offset(one.lat_deg, one.lon_deg, x * half, y * half));
      right.push(offset(one.lat_deg, one.lon_deg, -x * half, -y * half));
    }
    at = place;
  }
  return left.length < 2 ? null : [...left, ...right.reverse(), left[0]!];
}

/** How far an ellipse reaches in a direction (m). */
function acrossM(place: TrackPlace, east: number, north: number): number {
  const sin = Math.sin(place.azimuth_deg * RAD), cos = Math.cos(place.azimuth_deg * RAD);
  return Math.hypot(place.semi_major_m * (sin * east + cos * north), place.semi_minor_m * (cos * east - sin * north));
}

function towards(place: TrackPlace, courseDeg: number, far: number): [number, number] {
  return offset(place.lat_deg, place.lon_deg, far * Math.sin(courseDeg * RAD), far * Math.cos(courseDeg * RAD));
}

function arrow(place: TrackPlace, courseDeg: number, far: number): [number, number][] {
  const tip = towards(place, courseDeg, far), at = { ...place, lon_deg: tip[0], lat_deg: tip[1] };
  return [[place.lon_deg, place.lat_deg], tip, towards(at, courseDeg + 150, 0.25 * far), tip, towards(at, courseDeg - 150, 0.25 * far)];
}

function wedge(place: TrackPlace, courseDeg: number, halfDeg: number, far: number): [number, number][] {
  const arc = Array.from({ length: 13 }, (_, k) => towards(place, courseDeg - halfDeg + halfDeg * k / 6, far));
  const tip: [number, number] = [place.lon_deg, place.lat_deg];
  return [tip, ...arc, tip];
}
