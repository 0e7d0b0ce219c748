// A picture as it lies on the ground: rendered with north up, triangle by triangle, as far as it shows ground.

import type { GroundMesh } from "./types.js";

const LONGEST_PX = 800;
const SEAM_PX = 0.6; // each triangle reaches so far over its edges: between two there is no gap

type Place = [number, number];
/** Three points, each with its place in the picture and on the canvas, px. */
type Triangle = readonly { readonly from: Place; readonly to: Place }[];

/** Longitude and latitude of the canvas' corners, from the top left clockwise. */
export type Corners = [Place, Place, Place, Place];

/** Where a picture's triangles go on a canvas with north up. Null where none of it is ground. */
export function layout(mesh: GroundMesh, width: number, height: number): { corners: Corners; width: number; height: number; triangles: Triangle[] } | null {
  const { columns, lonlat } = mesh, rows = lonlat.length / columns;
  const cells: [number, number, number][] = [];
  for (let row = 0; row + 1 < rows; row++) {
    for (let column = 0; column + 1 < columns; column++) {
      const a = row * columns + column, b = a + 1, c = a + columns, d = c + 1;
      // At the edge of what is ground the half of a cell that has its three corners is used.
      const halves: [number, number, number][] = lonlat[a] !== null && lonlat[d] !== null ? [[a, b, d], [a, d, c]] : [[a, b, c], [b, d, c]];
      cells.push(...halves.filter((half) => half.every((k) => lonlat[k] !== null)));
    }
  }
  if (cells.length === 0) return null;
  const used = [...new Set(cells.flat())].map((k) => lonlat[k]!);
  const lons = used.map(([lon]) => lon), lats = used.map(([, lat]) => lat);
  const west = Math.min(...lons), east = Math.max(...lons), south = Math.min(...lats), north = Math.max(...lats);
  const wide = (east - west) * Math.cos((south + north) / 2 * Math.PI / 180), high = north - south;
  const scale = LONGEST_PX / Math.max(wide, high);
  const size = { width: Math.max(Math.round(wide * scale), 1), height: Math.max(Math.round(high * scale), 1) };
  const point = (k: number): { from: Place; to: Place } => {
    const [lon, lat] = lonlat[k]!;
    return {
      from: [(k % columns) / (columns - 1) * width, Math.floor(k / columns) / (rows - 1) * height],
      to: [(lon - west) / (east - west) * size.width, (north - lat) / (north - south) * size.height],
    };
  };
  return { ...size, corners: [[west, north], [east, north], [east, south], [west, south]], triangles: cells.map((cell) => cell.map(point)) };
}

/** The affine map of a triangle from the picture to the canvas, as a canvas takes it: a, b, c, d, e, f. */
export function affine([p, q, r]: Triangle): [number, number, number, number, number, number] {
  const [px, py] = p!.from, [ux, uy] = [q!.from[0] - px, q!.from[1] - py], [vx, vy] = [r!.from[0] - px, r!.from[1] - py];
  const [X, Y] = p!.to, [Ux, Uy] = [q!.to[0] - X, q!.to[1] - Y], [Vx, Vy] = [r!.to[0] - X, r!.to[1] - Y];
  const det = ux * vy - uy * vx;
  const a = (Ux * vy - Vx * uy) / det, c = (Vx * ux - Ux * vx) / det, b = (Uy * vy - Vy * uy) / det, d = (Vy * ux - Uy * vx) / det;
  return [a, b, c, d, X - a * px - c * py, Y - b * px - d * py];
}

/** The picture on a canvas of its own (the viewer closes its pictures when it drops them), and where that lies. */
export function onGround(image: ImageBitmap, mesh: GroundMesh | null): { canvas: HTMLCanvasElement; corners: Corners } | null {
  const laid = mesh === null ? null : layout(mesh, image.width, image.height);
  if (laid === null) return null;
  const canvas = document.createElement("canvas");
  canvas.width = laid.width;
  canvas.height = laid.height;
  const context = canvas.getContext("2d");
  if (context === null) return null;
  for (const triangle of laid.triangles) {
    const middle = [0, 1].map((k) => triangle.reduce((sum, { to }) => sum + to[k]!, 0) / 3) as Place;
    context.save();
    context.beginPath();
    for (const { to: [x, y] } of triangle) {
      const far = Math.hypot(x - middle[0], y - middle[1]) || 1;
      context.lineTo(x + (x - middle[0]) * SEAM_PX / far, y + (y - middle[1]) * SEAM_PX / far);
    }
    context.clip();
    context.setTransform(...affine(triangle));
    context.drawImage(image, 0, 0);
    context.restore();
  }
  return { canvas, corners: laid.corners };
}
