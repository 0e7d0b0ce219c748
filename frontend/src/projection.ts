// A place on the ground -> the pixel that shows it. Pure; the same as contract/geodesy.py, contract/camera.py and
// contract/rolling_shutter.py.

import type { Pixel, Size } from "./mapping.js";
import type { FrameView } from "./types.js";

export interface Camera {
  fx: number; fy: number; cx: number; cy: number;
  model: "pinhole" | "fisheye";
  distortion: number[]; // k1, k2, p1, p2, k3; a fisheye's k1, k2, k3, k4
  max_radius: number;
  lat_deg: number; lon_deg: number;
  height_m: number; is_ellipsoidal: boolean; undulation_m: number | null; // which height that is; ellipsoidal minus above sea level
  ground_per_m: Vector | null; // the ground plane's places X, m from the camera, have ground_per_m . X = 1; null: it stands upright
  R_enu_cam: number[]; // row by row
  shutter: Shutter | null;
}

/** How the camera moved while the picture's rows were read, and how long that took; null: all rows at once. */
export interface Shutter { readout_s: number; rate_rad_s: Vector; velocity_m_s: Vector }

const A_M = 6378137.0;
const F = 1.0 / 298.257223563;
const E2 = F * (2.0 - F);
const RAD = Math.PI / 180.0;
const SHUTTER_STEPS = 2; // as in contract/locate.py

type Vector = [number, number, number];

export function ecef(latDeg: number, lonDeg: number, heightM: number): Vector {
  const sinLat = Math.sin(latDeg * RAD), cosLat = Math.cos(latDeg * RAD);
  const normal = A_M / Math.sqrt(1.0 - E2 * sinLat * sinLat);
  const across = (normal + heightM) * cosLat;
  return [across * Math.cos(lonDeg * RAD), across * Math.sin(lonDeg * RAD), (normal * (1.0 - E2) + heightM) * sinLat];
}

/** East, north, up of a place (m) in the axes at another. */
export function enu(from: { lat_deg: number; lon_deg: number; height_m: number }, lat: number, lon: number, height: number): Vector {
  const a = ecef(from.lat_deg, from.lon_deg, from.height_m), b = ecef(lat, lon, height);
  const d: Vector = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
  const sl = Math.sin(from.lat_deg * RAD), cl = Math.cos(from.lat_deg * RAD);
  const so = Math.sin(from.lon_deg * RAD), co = Math.cos(from.lon_deg * RAD);
  return [
    -so * d[0] + co * d[1],
    -sl * co * d[0] - sl * so * d[1] + cl * d[2],
    cl * co * d[0] + cl * so * d[1] + sl * d[2],
  ];
}

/** The pixel of a place; null where the picture does not show it. `height` above the ellipsoid, as the camera's. */
export function pixelOf(camera: Camera, size: Size, lat: number, lon: number, height: number): Pixel | null {
  const e = enu(camera, lat, lon, height), R = camera.R_enu_cam;
  const cam: Vector = [0, 0, 0];
  for (let column = 0; column < 3; column++) {
    cam[column] = R[column]! * e[0] + R[3 + column]! * e[1] + R[6 + column]! * e[2];
  }
  if (cam[2] <= 1e-6) return null;
  const x = cam[0] / cam[2], y = cam[1] / cam[2], shutter = camera.shutter;
  let at = distorted(camera, x, y);
  if (shutter !== null) {
    // Each row sees the place at its own moment of exposure: (18.5) of docs/mathematics.md, from place to pixel.
    const [dx, dy] = imageVelocity(shutter, x, y, 1.0 / cam[2]);
    for (let step = 0; step < SHUTTER_STEPS && at !== null; step++) {
      const late = shutter.readout_s * (at.v - 0.5 * (size.height - 1)) / size.height;
      at = distorted(camera, x + late * dx, y + late * dy);
    }
  }
  const isSeen = at !== null && at.u >= -0.5 && at.v >= -0.5 && at.u <= size.width - 0.5 && at.v <= size.height - 0.5;
  return isSeen ? at : null;
}

/** The pixel of a place in a picture; null where the picture does not show it. One without a height lies on the ground. */
export function placeIn(frame: FrameView, place: { lat_deg: number; lon_deg: number; height_ellipsoid_m: number | null; height_amsl_m: number | null }): Pixel | null {
  if (frame.camera === null) return null;
  const height = heightIn(frame.camera, place) ?? groundHeight(frame, frame.camera, place.lat_deg, place.lon_deg);
  return height === null ? null : pixelOf(frame.camera, { width: frame.width_px, height: frame.height_px }, place.lat_deg, place.lon_deg, height);
}

/** A place's height as the camera's is given; null where that one is not known. As `placed_in` of ground/web/view.py. */
function heightIn(camera: Camera, place: { height_ellipsoid_m: number | null; height_amsl_m: number | null }): number | null {
  const { height_ellipsoid_m: ellipsoid, height_amsl_m: amsl } = place;
  if (!camera.is_ellipsoidal) return amsl;
  return ellipsoid ?? (amsl === null || camera.undulation_m === null ? null : amsl + camera.undulation_m);
}

/** The ground's height at a place: the plane's, and how high the features about the place are above it, the nearest most. */
export function groundHeight({ features }: Pick<FrameView, "features">, camera: Camera, lat: number, lon: number): number | null {
  const normal = camera.ground_per_m;
  if (normal === null) return null;
  let weights = 0, rise = 0;
  features.rise_m.forEach((above, k) => {
    const [e, n] = enu({ lat_deg: lat, lon_deg: lon, height_m: camera.height_m }, features.lonlat[k]![1], features.lonlat[k]![0], camera.height_m);
    const weight = 1 / (e * e + n * n + 1e-6);
    weights += weight;
    rise += weight * above;
  });
  const [e, n] = enu(camera, lat, lon, camera.height_m - 1 / Math.abs(normal[2]));
  return camera.height_m + (1 - e * normal[0] - n * normal[1]) / normal[2] + (weights > 0 ? rise / weights : 0);
}

/** Normalised image coordinates -> pixel; null beyond what the distortion describes. */
function distorted(camera: Camera, x: number, y: number): Pixel | null {
  if (Math.hypot(x, y) > camera.max_radius) return null;
  if (camera.model === "fisheye") return byAngle(camera, x, y);
  const [k1, k2, p1, p2, k3] = camera.distortion as [number, number, number, number, number];
  const r2 = x * x + y * y;
  const radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
  return {
    u: camera.cx + camera.fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)),
    v: camera.cy + camera.fy * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y),
  };
}

/** A fisheye's, whose radii go by the angle off the axis and not its tangent. (30.1) */
function byAngle(camera: Camera, x: number, y: number): Pixel {
  const [k1, k2, k3, k4] = camera.distortion as [number, number, number, number];
  const radius = Math.hypot(x, y), angle = Math.atan(radius), a2 = angle * angle;
  const scale = radius < 1e-9 ? 1.0 : angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))) / radius;
  return { u: camera.cx + camera.fx * x * scale, v: camera.cy + camera.fy * y * scale };
}

/** How a point that does not move on the ground moves over the picture, normalised, 1/s. (18.2) */
function imageVelocity({ rate_rad_s: [rx, ry, rz], velocity_m_s: [vx, vy, vz] }: Shutter, x: number, y: number, inverseDepth: number): [number, number] {
  const across = rx * y - ry * x;
  return [
    across * x - ry + rz * y + inverseDepth * (x * vz - vx),
    across * y + rx - rz * x + inverseDepth * (y * vz - vy),
  ];
}

/** A place east and north of another, within some kilometres (m): for drawing on the map. */
export function offset(lat: number, lon: number, east: number, north: number): [number, number] {
  const sinLat = Math.sin(lat * RAD);
  const w2 = 1.0 - E2 * sinLat * sinLat;
  const meridian = A_M * (1.0 - E2) / (w2 * Math.sqrt(w2));
  const parallel = A_M / Math.sqrt(w2) * Math.cos(lat * RAD);
  return [lon + east / parallel / RAD, lat + north / meridian / RAD];
}

/** Outline of an error ellipse, as longitude and latitude, closed. */
export function ellipseRing(lat: number, lon: number, major: number, minor: number, azimuthDeg: number, points = 36): [number, number][] {
  const ring: [number, number][] = [];
  const sin = Math.sin(azimuthDeg * RAD), cos = Math.cos(azimuthDeg * RAD);
  for (let k = 0; k <= points; k++) {
    const t = (k % points) * 2.0 * Math.PI / points;
    const along = major * Math.cos(t), across = minor * Math.sin(t);
    ring.push(offset(lat, lon, along * sin + across * cos, along * cos - across * sin));
  }
  return ring;
}
