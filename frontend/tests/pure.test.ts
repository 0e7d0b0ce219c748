// The pure modules: mapping under resize, zoom and any size, projection against Python's, grid, formats.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { contains, fitted, panned, resized, toPane, toPixel, wholeView, zoomed, MAX_ZOOM, type View } from "../src/mapping.js";
import { ellipseRing, enu, offset, pixelOf, placeIn, type Camera } from "../src/projection.js";
import { course, declination } from "../src/from-me.js";
import { affine, layout } from "../src/ground-picture.js";
import { groupTitle, isWanted } from "../src/fleet.js";
import { gridLines, gridStep } from "../src/grid.js";
import { newFinds } from "../src/news.js";
import { age, decimals, degrees, methodWords, radius, stepText, within } from "../src/format.js";
import { State } from "../src/state.js";
import { bandOf, trackFeatures } from "../src/map-tracks.js";
import { asOf, mergeReports, tracksAt, trackWords } from "../src/tracks.js";
import type { FoundSpot, FrameView, GroundMesh, Pin, PlaceAnswer, TrackReport, VehicleState } from "../src/types.js";

const PICTURE = { width: 640, height: 480 };

/** The same numbers every run. */
function* numbers(): Generator<number> {
  for (let state = 12345; ; ) { state = (state * 1103515245 + 12345) % 2147483648; yield state / 2147483648; }
}

function near(one: number, two: number, within: number): void {
  assert.ok(Math.abs(one - two) <= within, `${one} is not ${two}`);
}

test("of many aircraft those that are wanted are found by name, state or trouble, and the groups count them", () => {
  const fleet = Array.from({ length: 30 }, (_, k) => ({
    id: `uav-${k}`, state: k < 3 ? "lost" : k < 8 ? "warning" : "well", words: k === 4 ? "no GPS" : "ok", trouble: "",
  })) as VehicleState[];
  const found = (text: string): string[] => fleet.filter((one) => isWanted(one, text)).map((one) => one.id);
  assert.equal(found("").length, 30);
  assert.deepEqual(found("UAV-2"), ["uav-2", ...Array.from({ length: 10 }, (_, k) => `uav-${20 + k}`)]);
  assert.deepEqual(found("no gps"), ["uav-4"]);
  assert.deepEqual(found("lost uav-1"), ["uav-1"]);
  assert.deepEqual(found("nothing like it"), []);
  assert.equal(groupTitle("lost", fleet, ""), "3 lost");
  assert.equal(groupTitle("warning", fleet, "gps"), "1 of 5 with a warning");
  assert.equal(groupTitle("well", fleet, "gps"), "0 of 22 well");
  assert.equal(groupTitle("lost", fleet.slice(3), ""), "");
});

test("a pixel's centre lies half a scaled pixel inside the picture", () => {
  const view = wholeView(PICTURE, { width: 1280, height: 960 });
  assert.deepEqual(toPane(view, { u: 0, v: 0 }), { x: 1, y: 1 });
  assert.deepEqual(toPixel(view, { x: 0, y: 0 }), { u: -0.5, v: -0.5 });
  assert.deepEqual(toPixel(view, { x: 1280, y: 960 }), { u: 639.5, v: 479.5 });
});

test("whatever is zoomed, moved and resized, a point of the pane and its pixel stay together", () => {
  const random = numbers(), next = (): number => random.next().value as number;
  for (let run = 0; run < 300; run++) {
    let pane = fitted(PICTURE, { width: 200 + 1800 * next(), height: 200 + 1000 * next() });
    let view: View = wholeView(PICTURE, pane);
    for (let k = 0; k < 12; k++) {
      const at = { x: pane.width * next(), y: pane.height * next() };
      const before = toPixel(view, at), whole = wholeView(PICTURE, pane).scale;
      if (k % 3 === 0) {
        const factor = Math.exp(2 * next() - 0.6);
        view = zoomed(view, factor, at, PICTURE, pane);
        // Where nothing was held back, the pixel under the pointer is the same.
        if (factor > 1 && view.scale < whole * MAX_ZOOM) {
          near(toPixel(view, at).u, before.u, 1e-6);
          near(toPixel(view, at).v, before.v, 1e-6);
        }
      } else if (k % 3 === 1) {
        view = panned(view, 300 * (next() - 0.5), 300 * (next() - 0.5), PICTURE, pane);
      } else {
        const after = fitted(PICTURE, { width: 200 + 1800 * next(), height: 200 + 1000 * next() });
        const zoom = view.scale / whole;
        view = resized(view, PICTURE, pane, after);
        pane = after;
        near(view.scale / wholeView(PICTURE, pane).scale, zoom, 1e-9);
      }
      const there = toPane(view, toPixel(view, at));
      near(there.x, at.x, 1e-9 * pane.width);
      near(there.y, at.y, 1e-9 * pane.height);
      // No border is shown where there is picture, and the zoom keeps its bounds.
      assert.ok(view.left <= 1e-6 && view.left + PICTURE.width * view.scale >= pane.width - 1e-6);
      assert.ok(view.top <= 1e-6 && view.top + PICTURE.height * view.scale >= pane.height - 1e-6);
      const zoom = view.scale / wholeView(PICTURE, pane).scale;
      assert.ok(zoom >= 1 - 1e-9 && zoom <= MAX_ZOOM + 1e-9);
    }
  }
});

test("two fingers take what lies between them along", () => {
  const pane = { width: 640, height: 480 };
  const view = zoomed(wholeView(PICTURE, pane), 3, { x: 300, y: 200 }, PICTURE, pane, { x: 320, y: 240 });
  near(toPixel(view, { x: 320, y: 240 }).u, 299.5, 1e-9);
  near(toPixel(view, { x: 320, y: 240 }).v, 199.5, 1e-9);
});

test("the border belongs to the picture, half a pixel outside its centres", () => {
  assert.ok(contains(PICTURE, { u: -0.5, v: 479.5 }));
  assert.ok(!contains(PICTURE, { u: -0.51, v: 0 }));
  assert.ok(!contains(PICTURE, { u: 0, v: 479.51 }));
});

test("places are seen where Python sees them", () => {
  const cases = JSON.parse(readFileSync(process.env["PROJECTION_CASES"]!, "utf8")) as {
    camera: Camera; width: number; height: number; lat: number; lon: number; height_m: number; enu: number[]; uv: [number, number] | null;
  }[];
  assert.ok(cases.length >= 100);
  let seen = 0;
  for (const c of cases) {
    enu(c.camera, c.lat, c.lon, c.height_m).forEach((value, k) => near(value, c.enu[k]!, 1e-6));
    const uv = pixelOf(c.camera, { width: c.width, height: c.height }, c.lat, c.lon, c.height_m);
    assert.equal(uv === null, c.uv === null);
    if (uv !== null && c.uv !== null) { near(uv.u, c.uv[0], 1e-6); near(uv.v, c.uv[1], 1e-6); seen += 1; }
  }
  assert.ok(seen > cases.length / 4 && seen < cases.length);
});

test("a place of unknown height is where Python has the ground", () => {
  const cases = JSON.parse(readFileSync(process.env["GROUND_CASES"]!, "utf8")) as { frame: FrameView; place: PlaceAnswer; uv: [number, number] }[];
  assert.ok(cases.length >= 50);
  for (const { frame, place, uv } of cases) {
    const at = placeIn(frame, place);
    assert.ok(at !== null);
    near(Math.hypot(at.u - uv[0], at.v - uv[1]), 0, 8); // the page averages features where Python interpolates by kriging
  }
  const far = placeIn(cases[0]!.frame, { ...cases[0]!.place, lat_deg: cases[0]!.place.lat_deg + 0.01 });
  assert.equal(far, null);
});

test("a picture is laid on the ground without the corner that shows none", () => {
  const lonlat: ([number, number] | null)[] = [0, 1, 2].flatMap((row) => [0, 1, 2, 3].map((column): [number, number] => [8 + column * 1e-4, 47 - row * 1e-4]));
  const whole: GroundMesh = { columns: 4, lonlat }, cut: GroundMesh = { columns: 4, lonlat: lonlat.with(0, null) };
  assert.equal(layout(whole, 640, 480)!.triangles.length, 12);
  assert.equal(layout(cut, 640, 480)!.triangles.length, 11);
  assert.equal(layout({ columns: 4, lonlat: lonlat.map(() => null) }, 640, 480), null);
  const made = layout(cut, 640, 480)!;
  assert.deepEqual(made.corners, [[8, 47], [8 + 3e-4, 47], [8 + 3e-4, 47 - 2e-4], [8, 47 - 2e-4]]);
  for (const triangle of made.triangles) {
    const [a, b, c, d, e, f] = affine(triangle);
    for (const { from: [x, y], to: [u, v] } of triangle) {
      near(a * x + c * y + e, u, 1e-6);
      near(b * x + d * y + f, v, 1e-6);
      near(u / made.width, x / 640, 1e-6);
      near(v / made.height, y / 480, 1e-6);
    }
  }
});

test("an ellipse has its axes where they are stated to be", () => {
  const camera = { lat_deg: 47, lon_deg: 8, height_m: 0 };
  const ring = ellipseRing(47, 8, 20, 5, 30, 72);
  assert.deepEqual(ring[0], ring.at(-1));
  const away = ring.map(([lon, lat]) => enu(camera, lat, lon, 0));
  const far = away.map(([e, n]) => Math.hypot(e, n));
  near(Math.max(...far), 20, 0.01);
  near(Math.min(...far), 5, 0.01);
  const [e, n] = away[far.indexOf(Math.max(...far))]!;
  near(((Math.atan2(e, n) * 180 / Math.PI) + 180) % 180, 30, 0.1);
});

test("the grid has whole metres and covers the view", () => {
  assert.equal(gridStep(1000), 100);
  assert.equal(gridStep(1200), 200);
  assert.equal(gridStep(30), 5);
  const origin = { lat: -43, lon: 172 };
  const [east, north] = offset(-43, 172, 400, 250);
  const { step, lines } = gridLines(origin, [172, -43, east, north]);
  assert.equal(step, 50);
  assert.ok(lines.length >= 15 && lines.length <= 24);
  for (const line of lines) {
    assert.equal(line.metres % step, 0);
    for (const [lon, lat] of line.ends) {
      const [e, n] = enu({ lat_deg: -43, lon_deg: 172, height_m: 0 }, lat, lon, 0);
      assert.ok([e, n].some((value) => Math.abs(value - line.metres) < 0.1));
    }
  }
});

test("a radius is never shown smaller than it is", () => {
  for (const [metres, text] of [[3.21, "3.3 m"], [3.2, "3.2 m"], [9.95, "10.0 m"], [12.01, "13 m"], [999.5, "1000 m"], [1501, "1.6 km"]] as const) {
    assert.equal(radius(metres), text);
  }
  assert.equal(radius(null), "unknown");
  assert.equal(age(null), "age unknown");
  assert.equal(age(75), "75 s");
});

test("a grid's step is shown as it is", () => {
  for (const [metres, text] of [[0.5, "0.5 m"], [10, "10 m"], [200, "200 m"], [1000, "1 km"], [2000, "2 km"], [10_000, "10 km"], [100_000, "100 km"]] as const) {
    assert.equal(stepText(metres), text);
  }
});

test("a coordinate has the digits that its radius gives meaning to, as the server writes it", () => {
  for (const [ce90, places] of [[null, 5], [0.5, 6], [3.2, 6], [6, 5], [30, 5], [80, 4], [700, 3]] as const) assert.equal(decimals(ce90), places);
  assert.equal(degrees(-43.38012345, 172.40123456, 6), "-43.38012, 172.40123");
  assert.equal(within(3.21), "90 % within 3.3 m");
});

test("an answer's words are how it was found, how high above the ground, and why it was not measured", () => {
  const words = (method: string, above: number | null = null, unmeasured = ""): [string, string] =>
    methodWords({ method, above_ground_m: above, sigma_above_ground_m: above === null ? null : 0.42, unmeasured });
  assert.equal(words("measured", 6.13)[0], "measured, 6.1 ± 0.4 m above the ground");
  assert.equal(words("measured", -1.27)[0], "measured, 1.3 ± 0.4 m below the ground");
  assert.equal(words("interpolated")[0], "between measured points");
  assert.equal(words("terrain")[0], "from terrain");
  assert.match(words("interpolated", null, "two surfaces meet there")[1], /not measured by itself: two surfaces meet there/);
  assert.doesNotMatch(words("interpolated")[1], /not measured/);
});

function pin(id: string, name: string): Pin {
  return {
    id, number: 1, was: [], name, note: "", category: "poi", who: "", created_utc: "", seen_utc: null, modified_utc: "", modified_by: "", clicks: [],
    place: { status: "unplaced", reason: "" },
  };
}

test("an older state of a pin that comes later changes nothing: as an event, as a reply, in the list of all", () => {
  const state = new State(), name = (): string | undefined => state.pins.get("a")?.name;
  state.putPin(pin("a", "later"), 7);
  state.putPin(pin("a", "earlier"), 6);
  assert.equal(name(), "later");
  state.setPins([pin("a", "earlier"), pin("b", "another")], 6);
  assert.equal(name(), "later");
  assert.equal(state.pins.get("b")?.name, "another");
  state.setPins([], 6);
  assert.deepEqual([...state.pins.keys()], ["a"]);
  state.putPin(pin("a", "the same revision, read later"), 7);
  assert.equal(name(), "the same revision, read later");
  state.setPins([pin("a", "newest")], 8);
  assert.equal(name(), "newest");
});

test("a deleted pin does not come back with what was read before, and does with what was read after", () => {
  const state = new State();
  state.putPin(pin("a", "a pin"), 3);
  state.dropPin("a", 5);
  state.putPin(pin("a", "a pin"), 4);
  state.setPins([pin("a", "a pin")], 4);
  assert.equal(state.pins.size, 0);
  state.setPins([pin("a", "brought back")], 6);
  assert.equal(state.pins.size, 1);
  state.dropPin("a", 5);
  assert.equal(state.pins.size, 1);
});

test("after the connection was lost another server's revisions count", () => {
  const state = new State();
  state.putPin(pin("a", "of the old file"), 900);
  state.forgetRevisions();
  state.setPins([pin("b", "of the new file")], 2);
  assert.deepEqual([...state.pins.keys()], ["b"]);
});

const REPORT: TrackReport = {
  vehicle: "uav", session: 7, track: 1, frame: 10, capture_unix_ns: "1700000000000000000", u: 100, v: 90, size_px: 12,
  state: "followed", unseen: "", unseen_s: 0, words: "1.0 +-0.1 m/s towards 90 +-5 deg",
  place: { lat_deg: 47, lon_deg: 8, height_ellipsoid_m: 400, height_amsl_m: null, semi_major_m: 3, semi_minor_m: 1, azimuth_deg: 90 },
  course: { speed_m_s: 1, sigma_speed_m_s: 0.1, course_deg: 90, sigma_course_deg: 5 },
};
const BEGUN_MS = 1_700_000_000_000;

/** So many metres to the east and seconds later. */
function later(seconds: number, east: number, more: Partial<TrackReport> = {}): TrackReport {
  const [lon, lat] = offset(47, 8, east, 0), capture = BigInt(REPORT.capture_unix_ns) + BigInt(Math.round(seconds * 1e9));
  return { ...REPORT, frame: 10 + Math.round(seconds * 10), capture_unix_ns: String(capture), place: { ...REPORT.place!, lat_deg: lat, lon_deg: lon }, ...more };
}

test("reports of a track are held in the order of capture, and a lost thing's number begins again", () => {
  const held = new Map<string, TrackReport[]>();
  mergeReports(held, [later(1, 1), later(0, 0), later(1, 1), later(0.5, 0.5)]);
  assert.deepEqual(held.get("uav/7/1")!.map((one) => one.frame), [10, 15, 20]);
  mergeReports(held, [later(2, 2, { state: "lost" }), later(2.5, 2, { state: "lost" })]);
  assert.equal(held.get("uav/7/1")!.length, 5);
  mergeReports(held, [later(30, 9)]);
  assert.deepEqual(held.get("uav/7/1")!.map((one) => one.frame), [310]);
});

test("a track is as it was at the moment that is looked at: followed, lost, ended, forgotten", () => {
  const held = new Map<string, TrackReport[]>();
  mergeReports(held, [0, 1, 2, 3].map((at) => later(at, at, at === 3 ? { state: "coasting", unseen: "hidden" } : {})));
  const at = (seconds: number): string[] => tracksAt(held, () => BEGUN_MS + 1000 * seconds).map((track) => `${track.phase} ${track.path.length}`);
  assert.deepEqual(at(-1), []);
  assert.deepEqual(at(1), ["followed 2"]);
  assert.deepEqual(at(4), ["coasting 4"]);
  assert.deepEqual(at(7), ["lost 4"]);
  assert.deepEqual(at(9), ["ended 4"]);
  assert.deepEqual(at(124), []);
  assert.equal(trackWords(tracksAt(held, () => BEGUN_MS + 3000)[0]!), `coasting (hidden): ${REPORT.words}`);
  assert.ok(trackWords(tracksAt(held, () => BEGUN_MS + 9000)[0]!).startsWith("ended"));
});

test("where no report comes a place moves on with its speed, its ellipse grows as in contract/track_age.py, and then it is lost", () => {
  const aged = asOf(later(0, 0), BEGUN_MS + 2700), { lat_deg, lon_deg, semi_major_m, semi_minor_m, azimuth_deg } = aged.place!;
  assert.deepEqual([aged.state, aged.unseen, aged.capture_unix_ns], ["coasting", "no report", "1700000002700000000"]);
  near(enu({ lat_deg: 47, lon_deg: 8, height_m: 400 }, lat_deg, lon_deg, 400)[0]!, 2.7, 0.01);
  near(semi_major_m, 13.263, 0.01);
  near(semi_minor_m, 12.955, 0.01);
  near(azimuth_deg, 90, 0.1);
  const lost = asOf(later(0, 0), BEGUN_MS + 3600);
  assert.deepEqual([lost.state, lost.place, lost.course], ["lost", null, null]);
});

test("the band about a path is as wide as the ellipses reach across it, and a thing at rest has none", () => {
  const places = [0, 10, 20].map((east) => later(east, east).place!);
  const band = bandOf(places)!.map(([lon, lat]) => enu({ lat_deg: 47, lon_deg: 8, height_m: 400 }, lat, lon, 400));
  assert.equal(band.length, 7);
  for (const [, north] of band) near(Math.abs(north), 1, 0.01); // the ellipses lie along the way: their minor axis is across
  near(Math.min(...band.map(([east]) => east)), 0, 0.01);
  near(Math.max(...band.map(([east]) => east)), 20, 0.01);
  assert.equal(bandOf([REPORT.place!, REPORT.place!, REPORT.place!]), null);
});

test("on the map a moving thing has an arrow and a wedge, one at rest neither, and a lost one its last ellipse", () => {
  const kinds = (...reports: TrackReport[]): Record<string, number> => {
    const held = new Map<string, TrackReport[]>();
    mergeReports(held, reports);
    const made = trackFeatures(tracksAt(held, () => BEGUN_MS + 20_000)), kinds = [...made.areas, ...made.lines].map((one) => String(one.properties["kind"]));
    return Object.fromEntries([...new Set(kinds)].map((kind) => [kind, kinds.filter((one) => one === kind).length]));
  };
  assert.deepEqual(kinds(later(10, 0), later(20, 10)), { band: 1, ellipse: 1, wedge: 1, path: 1, edge: 1, arrow: 1 });
  const rest = { course: { speed_m_s: 0.03, sigma_speed_m_s: 0.1, course_deg: null, sigma_course_deg: null } };
  assert.deepEqual(kinds(later(20, 0, rest)), { ellipse: 1, edge: 1 });
  assert.deepEqual(kinds(later(10, 0), later(20, 10, { state: "lost", unseen: "hidden" })), { band: 1, ellipse: 1, path: 1, edge: 1 });
  assert.deepEqual(kinds(later(20, 0, { place: null })), {});
});

test("a bearing is from true north, and the compass differs by what the World Magnetic Model states, or is not known", async () => {
  const here = { lat_deg: 47, lon_deg: 8, height_m: 0 };
  const [lon, lat] = offset(47, 8, -3000, 4000), found = course(here, lat, lon);
  near(found.metres, 5000, 3);
  near((found.bearing + 360) % 360, 323.13, 0.05);
  // Test values of the model's own report, at sea level in 2025.0 and 2027.5.
  near((await declination({ lat_deg: 80, lon_deg: 0, height_m: 0 }, new Date("2025-01-01")))!, 1.28, 0.05);
  near((await declination({ lat_deg: -80, lon_deg: 240, height_m: 0 }, new Date("2027-07-02")))!, 68.49, 0.05);
  assert.equal(await declination(here, new Date("2031-01-01")), null);
});

test("a find is new once, and another one of its number after the server began again is new too", () => {
  const known = new Map<number, string>();
  const find = (spot: number, first_utc: string): FoundSpot => ({ spot, first_utc }) as FoundSpot;
  const first = find(1, "2026-11-30T10:00:00.000000Z"), second = find(2, "2026-11-30T10:00:05.000000Z");
  assert.deepEqual(newFinds(known, [first]), [first]);
  assert.deepEqual(newFinds(known, [first, second]), [second]);
  assert.deepEqual(newFinds(known, [find(1, "2026-11-30T09:59:58.000000Z"), second]), []);  // an earlier look came late
  const other = find(1, "2026-11-30T11:00:00.000000Z");
  assert.deepEqual(newFinds(known, [other]), [other]);
});
