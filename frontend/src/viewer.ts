// Which picture is shown: the newest, a frozen one, or one stepped to; and the pictures and sets around it, kept.

import { api } from "./api.js";
import type { State } from "./state.js";
import type { FrameRow, FrameView } from "./types.js";

const KEPT = 60;
const PLAY_MS = 250;
// Where only some of the frames have a picture, as those that cross the link: the last one is shown as long as this.
const PICTURE_NS = 10_000_000_000n;

export interface Loaded { view: FrameView; image: ImageBitmap | null; url: string | null }

export class Viewer {
  loaded: Loaded | null = null;
  private readonly kept = new Map<string, Loaded>();
  private readonly held = new Set<object>();
  private wanted: FrameRow | null = null;
  private isLoading = false;
  private timer = 0;

  constructor(private readonly state: State) {
    state.on(["frames", "vehicles"], () => this.follow());
  }

  /** While a finger is on the picture it stays the same picture: what comes is shown at the release. */
  hold(who: object): void { this.held.add(who); }

  release(who: object): void {
    this.held.delete(who);
    this.follow();
  }

  choose(vehicle: string): void {
    this.state.vehicle = vehicle;
    this.state.isFrozen = false;
    this.pause();
    this.state.notify("vehicles");
    this.state.notify("frames");
  }

  /**
   * Show the newest, or the newest that has a picture if that is not much older, unless the operator looks at another.
   * A better revision of the one shown is taken over, and its picture when it comes.
   */
  follow(): void {
    const rows = this.state.rows(), newest = rows.at(-1);
    if (newest === undefined || this.held.size > 0) return;
    const shown = this.state.shown;
    const isOther = shown === null || shown.vehicle !== this.state.vehicle || shown.session !== newest.session;
    if (isOther || !this.state.isFrozen) {
      const any = isOther && !newest.status.startsWith("ok") ? rows.findLast((row) => row.status === "ok") ?? newest : newest;
      this.show(withPicture(rows, any));
    } else {
      const same = rows.find((row) => row.frame === shown.frame);
      const hasNews = same !== undefined && (same.revision > shown.revision || (same.has_picture && this.loaded?.url === null));
      if (hasNews) this.show(same);
    }
  }

  freeze(isFrozen: boolean): void {
    this.state.isFrozen = isFrozen;
    this.pause();
    this.state.notify("shown");
    if (!isFrozen) this.follow();
  }

  step(by: number): void {
    const rows = this.state.rows();
    const at = this.index();
    const row = rows[Math.min(Math.max(at + by, 0), rows.length - 1)];
    this.state.isFrozen = true;
    if (row !== undefined) this.show(row);
    this.state.notify("shown");
  }

  goTo(index: number): void {
    const row = this.state.rows()[index];
    this.state.isFrozen = true;
    if (row !== undefined) this.show(row);
    this.state.notify("shown"); // at once: the button, pressed before the picture is there, would let go
  }

  /** Open a picture by name: of any vehicle. */
  open(vehicle: string, frame: number): void {
    if (this.state.vehicle !== vehicle) this.choose(vehicle);
    const at = this.state.rows().findIndex((row) => row.frame === frame);
    if (at >= 0) this.goTo(at);
  }

  play(): void {
    if (this.index() >= this.state.rows().length - 1) this.goTo(0);
    this.state.isPlaying = true;
    this.state.isFrozen = true;
    this.state.notify("shown");
    this.timer = window.setInterval(() => {
      if (this.isLoading || this.held.size > 0) return;
      if (this.index() >= this.state.rows().length - 1) this.pause();
      else this.goTo(this.index() + 1);
    }, PLAY_MS);
  }

  pause(): void {
    window.clearInterval(this.timer);
    if (this.state.isPlaying) {
      this.state.isPlaying = false;
      this.state.notify("shown");
    }
  }

  /** Where the picture wanted last is in the list. */
  index(): number {
    const rows = this.state.rows();
    const frame = this.wanted?.frame ?? this.state.shown?.frame ?? -1;
    const at = rows.findIndex((row) => row.frame === frame);
    return at < 0 ? rows.length - 1 : at;
  }

  private show(row: FrameRow): void {
    this.wanted = row;
    if (!this.isLoading) void this.load();
  }

  /** One request at a time: of pictures that come faster than they load, the newest is next. */
  private async load(): Promise<void> {
    this.isLoading = true;
    try {
      for (let row = this.wanted, vehicle = this.state.vehicle; row !== null && vehicle !== null;) {
        const [frame, has]: [string, boolean] = [`${vehicle}/${row.session}/${row.frame}`, row.has_picture];
        const key = `${frame}/${row.revision}/${has}`;
        let loaded = this.kept.get(key);
        if (loaded === undefined) {
          loaded = await fetched(vehicle, row, this.kept.get(`${frame}/${row.revision - 1}/${has}`));
          this.kept.set(key, loaded);
          this.forget();
        }
        // If a finger has touched the picture in the meantime, that picture stays.
        // What is shown already is not shown again: every release of the pointer asks for the newest.
        if (loaded !== this.loaded && this.held.size === 0 && this.state.vehicle === vehicle) {
          this.loaded = loaded;
          this.state.shown = loaded.view;
          this.state.notify("shown");
        }
        if (this.wanted === row && this.state.vehicle === vehicle) break;
        [row, vehicle] = [this.wanted, this.state.vehicle];
      }
    } catch {
      // The server does not answer, or the picture is gone: what is shown stays, and the next event tries again.
    } finally {
      this.isLoading = false;
    }
  }

  private forget(): void {
    for (const [key, old] of this.kept) {
      if (this.kept.size <= KEPT) break;
      if (old === this.loaded) continue;
      this.kept.delete(key);
      const isUsed = [...this.kept.values()].some((other) => other.image === old.image);
      if (!isUsed) old.image?.close();
    }
  }
}

/** The newest row with a picture, if it is hardly older than this one; else this one. */
function withPicture(rows: FrameRow[], newest: FrameRow): FrameRow {
  if (newest.has_picture) return newest;
  const oldest_ns = BigInt(newest.capture_unix_ns) - PICTURE_NS;
  for (let k = rows.length - 1; k >= 0; k--) {
    const row = rows[k];
    if (row === undefined || BigInt(row.capture_unix_ns) < oldest_ns) break;
    if (row.has_picture && BigInt(row.capture_unix_ns) <= BigInt(newest.capture_unix_ns)) return row;
  }
  return newest;
}

async function fetched(vehicle: string, row: FrameRow, before: Loaded | undefined): Promise<Loaded> {
  const url = row.has_picture ? api.pictureUrl(vehicle, row.session, row.frame) : null;
  const [view, image] = await Promise.all([
    api.features(vehicle, row.session, row.frame),
    before?.image ?? (url === null ? null : picture(url)),
  ]);
  return { view, image, url };
}

async function picture(url: string): Promise<ImageBitmap | null> {
  try {
    const answer = await fetch(url, { credentials: "same-origin" });
    return answer.ok ? await createImageBitmap(await answer.blob()) : null;
  } catch {
    return null;
  }
}
