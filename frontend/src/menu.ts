// Something that opens at its button, and closes by it, by Escape and by a press elsewhere.

import { byId } from "./dom.js";

export class Menu {
  constructor(private readonly button: HTMLElement, private readonly body: HTMLElement) {
    button.addEventListener("click", () => this.open(body.hidden === true));
    document.addEventListener("pointerdown", (event) => {
      const at = event.target as Node;
      if (!body.hidden && !body.contains(at) && !button.contains(at)) this.open(false);
    });
    document.addEventListener("keydown", (event) => {
      if (event.key !== "Escape" || body.hidden) return;
      if (body.contains(document.activeElement)) button.focus();
      this.open(false);
    });
  }

  open(isOpen: boolean): void {
    this.body.hidden = !isOpen;
    this.button.setAttribute("aria-expanded", String(isOpen));
  }
}

/** The layers of picture and map. It closes where it would hide what is shown on the picture for some seconds only. */
export function layersMenu(): void {
  const menu = new Menu(byId("layers"), byId("layers-menu"));
  for (const id of ["show-features", "show-paths", "download-area"]) byId(id).addEventListener("click", () => menu.open(false));
}
