// A fire on the map: what burned in the last minutes, as seen, surely and perhaps; its size and how fast it spreads.

import type { GeoJSONSource, Map as MapLibreMap } from "maplibre-gl";
import { api } from "./api.js";
import { byId, make, setText } from "./dom.js";
import { collection } from "./map-layers.js";
import type { FireReply } from "./types.js";

const LOOK_MS = 5000;
const MINUTES = ["1", "5", "15", "60"], FIRST = "5";
const COLOURS: [string, string, number][] = [["perhaps", "#e08600", 0.18], ["burned", "#d0021b", 0.3], ["surely", "#7a0012", 0.4]];

export class FireLayer {
  private isOn = false;
  private timer = 0;
  private turnCount = 0;
  private minutes = FIRST;
  private readonly panel = byId("fire-panel");
  private readonly words = make("p", { class: "seen-sum", "data-testid": "fire-words" });

  constructor(private readonly map: MapLibreMap, above: string) {
    map.addSource("fire", { type: "geojson", data: collection([]) });
    for (const [kind, colour, opacity] of COLOURS) {
      map.addLayer({ id: `fire-${kind}`, type: "fill", source: "fire", filter: ["==", ["get", "kind"], kind], paint: { "fill-color": colour, "fill-opacity": opacity } }, above);
      map.addLayer({ id: `fire-${kind}-edge`, type: "line", source: "fire", filter: ["==", ["get", "kind"], kind], paint: { "line-color": colour, "line-width": kind === "burned" ? 2 : 1 } }, above);
    }
    const choice = make("select", { "aria-label": "what burned in the last minutes", "data-testid": "fire-minutes" }, ...MINUTES.map((text) => make("option", { value: text, selected: text === FIRST }, `${text} min`)));
    choice.addEventListener("change", () => { this.minutes = choice.value; void this.look(); });
    const legend = make("ul", { class: "fire-legend" }, ...COLOURS.map(([kind, colour]) => {
      const swatch = make("i", {});
      swatch.style.background = colour;
      return make("li", {}, swatch, kind);
    }));
    this.panel.append(make("div", { class: "seen-head" }, make("strong", {}, "Fire"), choice), legend, this.words);
    byId("show-fire").addEventListener("click", () => this.turn(!this.isOn));
  }

  private turn(on: boolean): void {
    this.isOn = on;
    byId("show-fire").setAttribute("aria-pressed", String(on));
    this.panel.hidden = !on;
    window.clearTimeout(this.timer);
    if (on) void this.look(); else this.draw([]);
  }

  private async look(): Promise<void> {
    window.clearTimeout(this.timer);
    const turn = ++this.turnCount;
    try {
      const reply = await api.fire(this.minutes);
      if (!this.isOn || turn !== this.turnCount) return;
      setText(this.words, reply.words);
      this.draw(reply.features);
    } catch { /* the page shows that the server does not answer */ }
    if (this.isOn && turn === this.turnCount) this.timer = window.setTimeout(() => void this.look(), LOOK_MS);
  }

  private draw(features: FireReply["features"]): void {
    (this.map.getSource("fire") as GeoJSONSource).setData(collection(features));
  }
}
