// Things that are followed: what is known of each at a moment, and where it is in a picture. Pure: no DOM.

import { contains, type Pixel } from "./mapping.js";
import { offset, placeIn } from "./projection.js";
import type { FrameView, TrackPlace, TrackReport } from "./types.js";

const SILENT_MS = 5000; // without a report: it was ended, for a track is reported twice a second
const SHOWN_MS = 120_000; // for which an ended one is still shown
const NEAR_MS = 1000; // how far a picture may be from the nearest report and still show the thing
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
    const last = path.at(-1);
    if (last === undefined || now - captureMs(last.capture_unix_ns) > SHOWN_MS) continue;
    const isSilent = now - captureMs(last.capture_unix_ns) > SILENT_MS;
    out.push({ key, number: last.track, vehicle: last.vehicle, last, path, phase: last.state !== "lost" && isSilent ? "ended" : last.state });
  }
  return out.sort((a, b) => a.vehicle.localeCompare(b.vehicle, "en", { numeric: true }) || a.number - b.number);
}

/** A track's state, and why it is not seen if it is not. */
export function stateWords(track: TrackNow): string {
  return track.phase === "ended" ? "ended" : track.last.state + (track.last.unseen === "" ? "" : ` (${track.last.unseen})`);
}

/** How a track is, in words: its state and why, and how it moves. */
export function trackWords(track: TrackNow): string { return `${stateWords(track)}: ${track.last.words}`; }

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
    return { ...before.place, lat_deg: before.place.lat_deg + part * (after.place.lat_deg - before.place.lat_deg), lon_deg: before.place.lon_deg + part * (after.place.lon_deg - before.place.lon_deg) };
  }
  const nearest = near(before) ? before : near(after) ? after : null;
  if (nearest?.place == null) return null;
  const course = nearest.course, seconds = (ms - captureMs(nearest.capture_unix_ns)) / 1000;
  if (course === null || course.course_deg === null) return nearest.place;
  const way = course.speed_m_s * seconds, angle = course.course_deg * Math.PI / 180;
  const [lon, lat] = offset(nearest.place.lat_deg, nearest.place.lon_deg, way * Math.sin(angle), way * Math.cos(angle));
  return { ...nearest.place, lat_deg: lat, lon_deg: lon };
}
