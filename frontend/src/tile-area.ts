// Downloading the area that the map shows: how much it is, how it goes, and its end. The server fetches the tiles.

import { api } from "./api.js";
import { byId, make, setText } from "./dom.js";
import type { MapPane } from "./map.js";
import type { AreaPlan, AreaState, AreaView } from "./types.js";

const LOOK_MS = 500;

export class TileArea {
  private readonly dialog = byId<HTMLDialogElement>("area-dialog");
  private readonly deepest = byId<HTMLSelectElement>("area-deepest");
  private readonly progress = byId<HTMLProgressElement>("area-progress");
  private view: AreaView | null = null;
  private timer = 0;

  constructor(private readonly map: () => MapPane | null) {
    byId("download-area").addEventListener("click", () => void this.open());
    byId("area-go").addEventListener("click", () => void this.begin());
    byId("area-cancel").addEventListener("click", () => void this.run(async () => this.follow(await api.cancelArea())));
    this.dialog.addEventListener("close", () => window.clearTimeout(this.timer));
  }

  /** Show how much it would be; of a download that is under way, how it goes. */
  private async open(): Promise<void> {
    this.buttons(false, false);
    setText(byId("area-words"), "Asking the server of the tiles ...");
    this.dialog.showModal();
    await this.run(async () => {
      const now = await api.area();
      if (now.state === "running") { this.follow(now); return; }
      const map = this.map();
      if (map === null) throw new Error("this browser draws no map");
      this.view = map.view();
      const plan = await api.planArea(this.view);
      this.deepest.replaceChildren(...plan.choices.map((choice) => make("option", { value: String(choice.deepest) }, choiceText(choice))));
      this.deepest.selectedIndex = plan.choices.length - 1;
      setText(byId("area-words"), `From zoom ${plan.first}. ${plan.attribution === "" ? "No attribution is known: state it with --tiles-attribution." : plan.attribution.replace(/<[^>]*>/g, "")}`);
      this.buttons(true, false);
    });
  }

  private async begin(): Promise<void> {
    const view = this.view;
    if (view === null) return;
    this.buttons(false, false);
    await this.run(async () => this.follow(await api.downloadArea({ ...view, deepest: Number(this.deepest.value) })));
  }

  /** Show how it stands, again and again until it has ended. */
  private follow(now: AreaState): void {
    window.clearTimeout(this.timer);
    const isRunning = now.state === "running";
    this.buttons(false, isRunning);
    this.progress.max = Math.max(now.of, 1);
    this.progress.value = now.tiles + now.gaps;
    const isUsed = isRunning || now.tiles === 0 || this.map()?.useKept(now.format === "pbf") === true;
    setText(byId("area-words"), stateText(now) + (isUsed ? "" : " Load the page again to see them."));
    this.dialog.dataset["state"] = now.state; // what a test may wait for
    if (isRunning && this.dialog.open) this.timer = window.setTimeout(() => void this.run(async () => this.follow(await api.area())), LOOK_MS);
  }

  private buttons(mayBegin: boolean, isRunning: boolean): void {
    byId("area-go").hidden = byId("area-choice").hidden = !mayBegin;
    byId("area-cancel").hidden = this.progress.hidden = !isRunning;
  }

  private async run(what: () => Promise<void>): Promise<void> {
    try {
      await what();
    } catch (error) {
      setText(byId("area-words"), error instanceof Error ? error.message : String(error));
    }
  }
}

function choiceText({ deepest, tiles, held, bytes }: AreaPlan["choices"][number]): string {
  return `${deepest}: ${tiles} tiles${held > 0 ? `, ${held} of them here` : ""}, about ${megabytes(bytes)}`;
}

function stateText(now: AreaState): string {
  const count = `${now.tiles} of ${now.of} tiles, ${megabytes(now.bytes)}${now.gaps > 0 ? `; ${now.gaps} are not at the address` : ""}`;
  switch (now.state) {
    case "running": return `Downloading: ${count}`;
    case "done": return `Downloaded: ${count}.`;
    case "cancelled": return `Cancelled; kept: ${count}.`;
    default: return `Stopped: ${now.words}. Kept: ${count}.`;
  }
}

function megabytes(bytes: number): string { return `${bytes < 1e6 ? (bytes / 1e6).toFixed(2) : (bytes / 1e6).toFixed(1)} MB`; }
