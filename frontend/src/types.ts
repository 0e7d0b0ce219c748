// What the server says. Kept beside ground/web/{api_vehicles,api_pins,pin_json,view}.py.

import type { Camera } from "./projection.js";

export type Category = "person" | "vehicle" | "fire" | "hazard" | "poi";

export interface FrameRow {
  session: number; frame: number; revision: number; status: string; capture_unix_ns: string; has_picture: boolean;
}

export interface FrameView {
  vehicle: string; session: number; frame: number; revision: number;
  status: string; reason: string; advice: string; time_utc: string; capture_unix_ns: string; age_s: number | null;
  width_px: number; height_px: number;
  camera: Camera | null;
  features: { uv: [number, number][]; lonlat: [number, number][]; paths: [number, number][][] };
  footprint: [number, number][];
  corners: [number, number][] | null;
  ce90_centre_m: number | null;
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

export interface PinClick {
  id: string; vehicle: string; session: number; frame: number | null; u_px: number | null; v_px: number | null;
  who: string; method: string; clicked_utc: string; capture_utc: string | null;
}

export interface Pin {
  id: string; number: number; name: string; note: string; category: Category; who: string;
  created_utc: string; modified_utc: string; modified_by: string; clicks: PinClick[]; place: Place;
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
  recording: boolean | null; trouble: string;
}

export interface Tiles { kind: "pmtiles" | "mbtiles" | "template"; url: string; format: string; max_zoom: number; attribution: string }

export interface ServerStatus { source: string; is_live: boolean; damage: string[]; sharing: string; tiles: Tiles | null; vehicles: VehicleState[] }

export interface ClickAnswer {
  status: string; advice: string; reason?: string; age_s: number | null; method?: string;
}

export interface PinReply { pin: Pin | null; answer: ClickAnswer | null }

export interface Seen {
  vehicle: string; session: number; frame: number; capture_unix_ns: string; u_px: number; v_px: number; has_picture: boolean;
}

export interface Handoff { texts: { name: string; title: string; text: string }[]; readback: string; geo: string }

export interface ClickBody { vehicle: string; session: number; frame: number; u: number; v: number }

export type ServerEvent =
  | { type: "frames"; vehicle: string; frames: FrameRow[] }
  | { type: "pin"; pin: Pin }
  | { type: "pin_deleted"; id: string }
  | { type: "pins" }
  | { type: "resync" }
  | { type: "status"; vehicles: VehicleState[]; damage: string[]; sharing: string };
