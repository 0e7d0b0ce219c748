// What the server sends. Must match ground/web/{api_vehicles,api_pins,api_spots,api_tracks,pin_json,seen_map,view}.py.

import type { Camera } from "./projection.js";

export type Category = "person" | "vehicle" | "fire" | "hazard" | "poi";

export interface FrameRow {
  session: number; frame: number; revision: number; status: string; capture_unix_ns: string; has_picture: boolean;
}

/** The ground's longitude and latitude under a lattice of pixels from edge to edge, row by row; null where there is none. */
export interface GroundMesh { columns: number; lonlat: ([number, number] | null)[] }

export interface FrameView {
  vehicle: string; session: number; frame: number; revision: number;
  status: string; reason: string; advice: string; time_utc: string; capture_unix_ns: string; age_s: number | null;
  width_px: number; height_px: number;
  camera: Camera | null;
  features: { uv: [number, number][]; lonlat: [number, number][]; rise_m: number[]; paths: [number, number][][] };
  footprint: [number, number][];
  mesh: GroundMesh | null;
  ce90_centre_m: number | null;
  spots: Record<string, [number, number]>; // pixels of the things that a machine found in it, by number
}

export interface Ellipse { semi_major_m: number; semi_minor_m: number; azimuth_deg: number }

export interface PlaceAnswer {
  lat_deg: number; lon_deg: number; height_ellipsoid_m: number | null; height_amsl_m: number | null;
  ce90_m: number | null; le90_m: number | null; ellipse: Ellipse | null; clicks: number; tied: number;
}

export type Place =
  | ({ status: "ok" } & PlaceAnswer)
  | { status: "contradiction"; reason: string; answers: PlaceAnswer[] }
  | { status: "unplaced"; reason: string };

/** How a click was answered: how high above the ground, if its pixel was measured by itself, or why it was not. */
export interface How { method: string; above_ground_m: number | null; sigma_above_ground_m: number | null; unmeasured: string }

export interface PinClick extends How {
  id: string; vehicle: string; session: number; frame: number | null; u_px: number | null; v_px: number | null;
  who: string; clicked_utc: string; capture_utc: string | null;
}

export interface Pin {
  id: string; number: number; was: number[]; name: string; note: string; category: Category; who: string;
  created_utc: string; seen_utc: string | null; modified_utc: string; modified_by: string; clicks: PinClick[]; place: Place;
}

export interface Tie {
  id: string; name: string; who: string; vehicle: string; session: number; frame: number; u_px: number; v_px: number;
  lat_deg: number; lon_deg: number; height_m: number | null; datum: string; sigma_m: number;
}

export interface VehicleState {
  id: string; session: number; is_live: boolean; frame: number | null;
  state: "well" | "warning" | "lost"; words: string; is_lost: boolean;
  picture_age_s: number | null; heard_age_s: number | null; sets_hz: number | null; kbit_s: number | null;
  features: number; tracks: number | null; ce90_centre_m: number | null; cpu_c: number | null;
  clock_unix_ns: string | null; place: [number, number] | null;
  recording: boolean | null; trouble: string;
  gps: string; battery: string; mode: string; // as its receiver and autopilot report them; empty: not known now
  unfollowed: string; // why it follows nothing that is clicked; empty: it may be asked
  unlooked: string; // why its camera can be sent nowhere; empty: it may be asked
  look: string; // who had it look where last, and what the autopilot made of it
  height_above_ground_m: number | null; // of the camera at the newest picture, over the ground at its centre
  height_amsl_m: number | null;
  person_found: number | null; // on which share of the ground in view its search for heat would find a person
  radius: string; // what the ellipse is mostly from, and what would make it smaller; empty: not known
}

/** An area of the map, and the zoom of its tiles. */
export interface AreaView { west: number; south: number; east: number; north: number; zoom: number }

/** What a download of an area would be, for each zoom that it may go down to; bytes are those still to be fetched. */
export interface AreaPlan { first: number; choices: { deepest: number; tiles: number; held: number; bytes: number }[]; attribution: string }

export interface AreaState { state: "idle" | "running" | "done" | "stopped" | "cancelled"; words: string; tiles: number; of: number; gaps: number; bytes: number; format: string }

export interface Tiles {
  kind: "pmtiles" | "mbtiles" | "tilejson" | "template" | "kept"; url: string; format: string; attribution: string;
  min_zoom: number; max_zoom: number; bounds: [number, number, number, number] | null;
  kept_from?: number; // the first zoom of what was downloaded
}

export interface ServerStatus { role: "operator" | "viewer" | "pointer"; source: string; is_live: boolean; measures: boolean; damage: string[]; sharing: string; tak: string; tiles: Tiles | null; vehicles: VehicleState[] }

/** The place that an aircraft would have its camera look at. */
/** `circle`: what the aircraft would fly about the place; null of an offer that turns the camera alone. */
export interface LookOffer { vehicle: string; ticket: string; lat_deg: number; lon_deg: number; height_amsl_m: number; ce90_m: number; circle: { radius_m: number; height_amsl_m: number; above_place_m: number } | null }

export interface ClickAnswer {
  status: string; advice: string; reason?: string; age_s: number | null; method?: string;
}

/** `apart_m` and `reason`: of a click that contradicts the pin it was meant for, and was not added. */
export interface PinReply { revision: number; pin: Pin | null; answer: ClickAnswer | null; apart_m?: number; reason?: string }

/** What a pin at a pixel would be. */
export type PlaceReply = { status: "ok" } & How & PlaceAnswer | { status: "refused"; reason?: string };

export interface CoordinateReply { lat_deg: number; lon_deg: number; form: string; texts: Record<string, string> }

export interface Seen {
  vehicle: string; session: number; frame: number; capture_unix_ns: string; u_px: number; v_px: number; has_picture: boolean;
}

export interface Handoff { texts: { name: string; title: string; text: string }[]; readback: string; geo: string }

export interface ClickBody { vehicle: string; session: number; frame: number; u: number; v: number }

/** What the server has views of: /api/NAME has all of them, an event of that name those that are new. */
export interface News { tracks: TrackReport; spots: FoundSpot }

export type ServerEvent =
  | { type: "frames"; vehicle: string; frames: FrameRow[] }
  | { type: "pin"; revision: number; pin: Pin }
  | { type: "pin_deleted"; revision: number; id: string }
  | { type: "pins" }
  | { type: "resync" }
  | { type: "tracks"; tracks: News["tracks"][] }
  | { type: "spots"; spots: News["spots"][] }
  | { type: "status"; vehicles: VehicleState[]; damage: string[]; sharing: string };

/** What a machine found; a person may have decided on it. */
export interface FoundSpot {
  spot: number; state: "open" | "confirmed" | "dismissed"; pin: string | null; is_sure: boolean; pictures: number; vehicles: string[];
  first_utc: string; last_utc: string; temperature_c: number | null; above_ground_k: number | null; contrast: number; kind: "person" | "vehicle" | "other" | null; probability: number | null; heat: string; motion: string;
  lat_deg: number; lon_deg: number; height_amsl_m: number | null; height_ellipsoid_m: number | null; ellipse: Ellipse; ce90_m: number;
  best: { vehicle: string; session: number; frame: number; u: number; v: number };
  is_moving?: boolean; // not there while too little is known
}

/** What burned: GeoJSON features, and in words. */
export interface FireReply { words: string; features: { type: "Feature"; geometry: { type: string; coordinates: unknown }; properties: Record<string, unknown> }[] }

export interface TrackPlace {
  lat_deg: number; lon_deg: number; height_ellipsoid_m: number | null; height_amsl_m: number | null;
  semi_major_m: number; semi_minor_m: number; azimuth_deg: number;
}

/** A thing that is followed, at one picture. At rest it has a speed and no course. */
export interface TrackReport {
  vehicle: string; session: number; track: number; frame: number; capture_unix_ns: string; u: number; v: number; size_px: number;
  state: "followed" | "coasting" | "lost"; unseen: string; unseen_s: number; words: string; place: TrackPlace | null;
  course: { speed_m_s: number; sigma_speed_m_s: number; course_deg: number | null; sigma_course_deg: number | null } | null;
}

export interface SeenState {
  version: number; cell_m: number | null; area_m2: number; pictures: number; ahead: number | null;
  is_live: boolean; left_out: number; is_full: boolean; trouble: string;
}

export type Finder = "machine" | "operator";

/** Who would have been found: of each finder its assumption and a line for each sector; `detection` null until computed. */
export interface SeenDetection {
  version: string; is_current: boolean; assumed: Record<Finder, string>; lines: Record<Finder, string[]>;
  detection: { searched_pictures: number; unmatched_reports: number } | null;
  sectors: { name: string; rings: [number, number][][] }[]; woods: number; trouble: string;
}

/** Rows to fly over gaps: in words, as a way of longitudes and latitudes, and the files of it by their kind. */
export interface FlightRows { words: string; height_m: number; way: [number, number][]; files: Record<string, string> }

export interface SeenPicture { vehicle: string; session: number; frame: number; capture_unix_ns: string; gsd_m: number }

export interface SeenAt {
  lat_deg: number; lon_deg: number; count: number; first_utc: string | null; last_utc: string | null; gsd_m: number | null;
  finest: SeenPicture | null; pictures: SeenPicture[];
}
