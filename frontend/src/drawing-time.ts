// How long the graphics take to draw the map: a moment with a graphics card, a good part of a second without.

import type { Map as MapLibreMap } from "maplibre-gl";

const LOOK_MS = 10;

/** Reports the milliseconds from when the map's commands were given until they were carried out. */
export class DrawingTime {
  private readonly gl: WebGL2RenderingContext | null;
  private isUnderWay = false;

  constructor(map: MapLibreMap, private readonly took: (ms: number) => void) {
    this.gl = map.getCanvas().getContext("webgl2"); // the one that the map has
    map.on("render", () => this.begin());
  }

  private begin(): void {
    const fence = this.isUnderWay ? null : this.gl?.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0) ?? null;
    if (fence === null) return;
    this.isUnderWay = true;
    this.gl?.flush();
    this.look(fence, performance.now());
  }

  private look(fence: WebGLSync, begunAt: number): void {
    const { gl } = this;
    window.setTimeout(() => {
      if (gl === null) return;
      const isDone = gl.isContextLost() || gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.UNSIGNALED;
      if (!isDone) { this.look(fence, begunAt); return; }
      gl.deleteSync(fence);
      this.isUnderWay = false;
      this.took(performance.now() - begunAt);
    }, LOOK_MS);
  }
}
