// Categories by colour and by shape: neither alone is relied on. Colours after Okabe and Ito, darkened where white text lies on them.

import type { Category } from "./types.js";

export interface Kind { readonly word: Category; readonly title: string; readonly colour: string; readonly path: string }

// Shapes in a square of 24.
export const KINDS: readonly Kind[] = [
  { word: "person", title: "Person", colour: "#b5490a", path: "M12 2a10 10 0 1 0 0 20a10 10 0 1 0 0-20z" },
  { word: "vehicle", title: "Vehicle", colour: "#0067a8", path: "M3 3h18v18h-18z" },
  { word: "fire", title: "Fire", colour: "#c4122f", path: "M12 1l11.5 21h-23z" },
  { word: "hazard", title: "Hazard", colour: "#8a6100", path: "M12 0.5l11.5 11.5l-11.5 11.5l-11.5-11.5z" },
  { word: "poi", title: "Point of interest", colour: "#00735a", path: "M12 1.5l10.5 7.8l-4 12.7h-13l-4-12.7z" },
];

export function kindOf(word: Category): Kind {
  return KINDS.find((kind) => kind.word === word) ?? KINDS[4]!;
}

/** Of aircraft: by colour and by dash on the map, by name everywhere. */
export const AIRCRAFT = ["#0a6ed1", "#b5490a", "#00735a", "#8e3a8c", "#8a6100", "#475569"] as const;

const SVG = "http://www.w3.org/2000/svg";

export function shapeSvg(kind: Kind, size: number, text = ""): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "-2 -2 28 28");
  svg.setAttribute("width", String(size));
  svg.setAttribute("height", String(size));
  svg.setAttribute("aria-hidden", "true");
  // A dark edge outside the white one, so that it is visible on any ground.
  for (const [stroke, width] of [["#000", "4"], ["#fff", "2"]] as const) {
    const path = document.createElementNS(SVG, "path");
    path.setAttribute("d", kind.path);
    path.setAttribute("fill", kind.colour);
    path.setAttribute("stroke", stroke);
    path.setAttribute("stroke-width", width);
    path.setAttribute("stroke-linejoin", "round");
    svg.append(path);
  }
  if (text !== "") {
    const label = document.createElementNS(SVG, "text");
    label.setAttribute("x", "12");
    label.setAttribute("y", kind.word === "fire" ? "20" : "16.4");
    label.setAttribute("text-anchor", "middle");
    label.setAttribute("font-size", text.length > 2 ? "9" : "12");
    label.setAttribute("font-weight", "700");
    label.setAttribute("fill", "#fff");
    label.textContent = text;
    svg.append(label);
  }
  return svg;
}
