// Things that are followed: what is known of each at a moment, and where it is in a picture. Pure: no DOM.

import { contains, type Pixel } from "./mapping.js";
import { offset, placeIn } from "./projection.js";
import type { FrameView, TrackPlace, TrackReport } from "./types.js";

const SILENT_MS = 5000; // without a report: it was ended, for a track is reported twice a second
const SHOWN_MS = 120_000; // for which an ended one is still shown
const LAG_MS = 1500; // of which a report may be old when it comes, and until the next one does
const COASTS_MS = 1000, LOST_MS = 2000; // without anything newer, as contract/track_age.py has it
const ACCELERATION_M_S2 = 1.5, TURN_RAD_S = 0.15, UNKNOWN_M_S = 12, SIGMAS = 2.146; // likewise; a 90 % semi-axis in sigmas
const NEAR_MS = 1000; // how far a picture may be from the nearest report and still show the thing
const OLD_LOOK_S = 0.5; // an older look's age is written
const NO_SIZE_PX = 24; // of a thing in another aircraft's picture

/** "ended": it is no longer reported, as the operator wished. */
export type Phase = "followed" | "coasting" | "lost" | "ended";

/** A track as it is at a moment: its newest report then, and all before. */
export interface TrackNow { readonly key: string; readonly number: number; readonly vehicle: string; readonly phase: Phase; readonly last: TrackReport; readonly path: readonly TrackReport[] }

export function trackKey(report: TrackReport): string { return `${report.vehicle}/${report.session}/${report.track}`; }

export function captureMs(unixNs: string): number { return Number(BigInt(unixNs) / 1000n) / 1000; }

/** Take reports that came: in the order of capture, none twice; of a lost thing's number that comes again only what is new. */
export function mergeReports(held: Map<string, TrackReport[]>, reports: readonly TrackReport[]): void {
  for (const report of reports) {
    const key = trackKey(report), path = held.get(key) ?? [], last = path.at(-1);
    if (last !== undefined && last.state === "lost" && report.state !== "lost" && BigInt(report.capture_unix_ns) > BigInt(last.capture_unix_ns)) path.length = 0;
    const at = path.findIndex((one) => BigInt(one.capture_unix_ns) >= BigInt(report.capture_unix_ns));
    if (at < 0) path.push(report);
    else if (path[at]!.capture_unix_ns !== report.capture_unix_ns) path.splice(at, 0, report);
    held.set(key, path);
  }
}

/** All tracks that are shown at each aircraft's moment (ms since 1970), by vehicle and number. */
export function tracksAt(held: ReadonlyMap<string, readonly TrackReport[]>, nowMs: (vehicle: string) => number): TrackNow[] {
  const out: TrackNow[] = [];
  for (const [key, all] of held) {
    const now = nowMs(all[0]?.vehicle ?? ""), path = all.filter((report) => captureMs(report.capture_unix_ns) <= now + NEAR_MS / 2);
    const newest = path.at(-1);
    if (newest === undefined || now - captureMs(newest.capture_unix_ns) > SHOWN_MS) continue;
    const isSilent = now - captureMs(newest.capture_unix_ns) > SILENT_MS, last = asOf(newest, now);
    out.push({ key, number: last.track, vehicle: last.vehicle, last, path, phase: newest.state !== "lost" && isSilent ? "ended" : last.state });
  }
  return out.sort((a, b) => a.vehicle.localeCompare(b.vehicle, "en", { numeric: true }) || a.number - b.number);
}

/** A report at a later moment (ms since 1970): its place has moved on and its ellipse grown, and it coasts or is lost. (24.19) */
export function asOf(report: TrackReport, ms: number): TrackReport {
  const ageMs = ms - captureMs(report.capture_unix_ns), silentMs = ageMs - LAG_MS, seconds = ageMs / 1000;
  if (ageMs <= 0) return report;
  const unseen_s = report.unseen_s + seconds, capture_unix_ns = String(BigInt(report.capture_unix_ns) + BigInt(Math.round(ageMs * 1e6)));
  const unseen = report.unseen === "" ? "no report" : report.unseen;
  if (report.state === "lost" || 1000 * report.unseen_s + silentMs > LOST_MS) return { ...report, capture_unix_ns, unseen_s, unseen, state: "lost", place: null, course: null };
  const aged: TrackReport = { ...report, capture_unix_ns, unseen_s, ...(silentMs > COASTS_MS ? { state: "coasting" as const, unseen } : {}) };
  return report.place === null ? aged : { ...aged, place: moved(report.place, report.course, report.unseen_s, seconds) };
}

function moved(place: TrackPlace, course: TrackReport["course"], unseenS: number, ageS: number): TrackPlace {
  const speed = course?.course_deg == null ? 0 : course.speed_m_s, angle = (course?.course_deg ?? 0) * Math.PI / 180;
  const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
  const alongS2 = (course?.sigma_speed_m_s ?? UNKNOWN_M_S) ** 2, acrossS2 = speed > 0 ? (speed * (course?.sigma_course_deg ?? 0) * Math.PI / 180) ** 2 : alongS2;
  const until = unseenS + ageS, squares = until ** 2 - unseenS ** 2, bend = 0.25 * (ACCELERATION_M_S2 + TURN_RAD_S * speed) ** 2 * (until ** 4 - unseenS ** 4);
  const sinE = Math.sin(place.azimuth_deg * Math.PI / 180), cosE = Math.cos(place.azimuth_deg * Math.PI / 180);
  const major = (place.semi_major_m / SIGMAS) ** 2, minor = (place.semi_minor_m / SIGMAS) ** 2;
  const ee = major * sinE * sinE + minor * cosE * cosE + squares * (alongS2 * sin * sin + acrossS2 * cos * cos) + bend;
  const nn = major * cosE * cosE + minor * sinE * sinE + squares * (alongS2 * cos * cos + acrossS2 * sin * sin) + bend;
  const en = (major - minor) * sinE * cosE + squares * (alongS2 - acrossS2) * sin * cos;
  const middle = 0.5 * (ee + nn), half = Math.hypot(0.5 * (ee - nn), en);
  const [lon, lat] = offset(place.lat_deg, place.lon_deg, speed * ageS * sin, speed * ageS * cos);
  const azimuth = (0.5 * Math.atan2(2 * en, nn - ee) * 180 / Math.PI + 180) % 180;
  return { ...place, lat_deg: lat, lon_deg: lon, semi_major_m: SIGMAS * Math.sqrt(middle + half), semi_minor_m: SIGMAS * Math.sqrt(Math.max(middle - half, 0)), azimuth_deg: azimuth };
}

/** A track's state, and why it is not seen if it is not. */
export function stateWords(track: TrackNow): string {
  if (track.phase === "ended") return "ended";
  const { state, unseen, unseen_s } = track.last;
  return state + (unseen === "" ? "" : ` (${unseen})`) + (state !== "followed" && unseen_s >= OLD_LOOK_S ? `, seen ${unseen_s.toFixed(1)} s ago` : "");
}

/** How a track is, in words: its state and why, and how it moves. */
export function trackWords(track: TrackNow): string { return track.phase === "lost" ? stateWords(track) : `${stateWords(track)}: ${track.last.words}`; }

/** Where a thing is in a picture, and how large (px); null where the picture does not show it or it is not known. */
export function seenIn(track: TrackNow, frame: FrameView): { at: Pixel; size: number } | null {
  if (track.phase === "lost" || track.phase === "ended") return null;
  const own = track.vehicle === frame.vehicle && track.last.session === frame.session;
  const size = { width: frame.width_px, height: frame.height_px };
  const same = own ? track.path.findLast((report) => report.frame === frame.frame) : undefined;
  if (same !== undefined) return contains(size, { u: same.u, v: same.v }) ? { at: { u: same.u, v: same.v }, size: same.size_px } : null;
  const at = placeAt(track.path, captureMs(frame.capture_unix_ns));
  if (at === null) return null;
  const pixel = placeIn(frame, at);
  return pixel === null ? null : { at: pixel, size: own ? track.last.size_px : NO_SIZE_PX };
}

/** Between the two reports about a moment; at most a second from the nearest, as its speed takes it. */
function placeAt(path: readonly TrackReport[], ms: number): TrackPlace | null {
  let before: TrackReport | null = null, after: TrackReport | null = null;
  for (const report of path) {
    if (report.place === null) continue;
    if (captureMs(report.capture_unix_ns) <= ms) before = report;
    else { after = report; break; }
  }
  const near = (report: TrackReport | null): boolean => report !== null && Math.abs(captureMs(report.capture_unix_ns) - ms) <= NEAR_MS;
  if (before?.place != null && after?.place != null && near(before) && near(after)) {
    const from = captureMs(before.capture_unix_ns), part = (ms - from) / Math.max(captureMs(after.capture_unix_ns) - from, 1);
    const turn = ((after.place.lon_deg - before.place.lon_deg + 540) % 360) - 180; // over the date line too
    return { ...before.place, lat_deg: before.place.lat_deg + part * (after.place.lat_deg - before.place.lat_deg), lon_deg: before.place.lon_deg + part * turn };
  }
  const nearest = near(before) ? before : near(after) ? after : null;
  if (nearest?.place == null) return null;
  const course = nearest.course, seconds = (ms - captureMs(nearest.capture_unix_ns)) / 1000;
  if (course === null || course.course_deg === null) return nearest.place;
  const way = course.speed_m_s * seconds, angle = course.course_deg * Math.PI / 180;
  const [lon, lat] = offset(nearest.place.lat_deg, nearest.place.lon_deg, way * Math.sin(angle), way * Math.cos(angle));
  return { ...nearest.place, lat_deg: lat, lon_deg: lon };
}
