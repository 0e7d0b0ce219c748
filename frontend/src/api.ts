// Requests to the server that served the page, and its events.

import type { AreaPlan, AreaState, AreaView, ClickBody, CoordinateReply, FireReply, FlightRows, FoundSpot, FrameRow, FrameView, Handoff, LookOffer, News, Pin, PinReply, PlaceReply, Seen, SeenAt, SeenDetection, SeenPicture, SeenState, ServerEvent, ServerStatus, Tie } from "./types.js";

export class Refused extends Error {
  constructor(readonly status: number, message: string, readonly body: unknown) { super(message); }
}

async function asked<T>(path: string, method = "GET", body?: unknown, expected: number[] = []): Promise<T> {
  const init: RequestInit = { method, credentials: "same-origin" };
  if (body !== undefined) {
    init.headers = { "content-type": body instanceof Blob ? "application/octet-stream" : "application/json" };
    init.body = body instanceof Blob ? body : JSON.stringify(body);
  }
  let answer: Response;
  try {
    answer = await fetch(path, init);
  } catch {
    throw new Refused(0, "the server does not answer; the page goes on trying", null);
  }
  const isJson = (answer.headers.get("content-type") ?? "").startsWith("application/json");
  const content: unknown = isJson ? await answer.json() : await answer.text();
  if (!answer.ok && !expected.includes(answer.status)) {
    const detail = isJson && content !== null && typeof content === "object" && "detail" in content ? content.detail : content;
    throw new Refused(answer.status, typeof detail === "string" ? detail : JSON.stringify(detail), content);
  }
  return content as T;
}

const part = encodeURIComponent;
const frameUrl = (vehicle: string, session: number, frame: number, what: string): string =>
  `/api/vehicles/${part(vehicle)}/frames/${frame}/${what}?session=${session}`;

export const api = {
  status: () => asked<ServerStatus>("/api/status"),
  frames: (vehicle: string) => asked<FrameRow[]>(`/api/vehicles/${part(vehicle)}/frames`),
  path: (vehicle: string) => asked<[number, number][]>(`/api/vehicles/${part(vehicle)}/path`),
  features: (vehicle: string, session: number, frame: number) => asked<FrameView>(frameUrl(vehicle, session, frame, "features")),
  pictureUrl: (vehicle: string, session: number, frame: number) => frameUrl(vehicle, session, frame, "picture"),
  seenState: () => asked<SeenState>("/api/seen"),
  seenDetection: () => asked<SeenDetection>("/api/seen/detection"),
  seenSectors: (file: File) => asked<{ sectors: number }>(`/api/seen/sectors?name=${part(file.name)}`, "POST", file),
  outlinedSector: (name: string, corners: [number, number][]) => asked<{ sectors: number }>("/api/seen/sectors/outline", "POST", { name, corners }),
  noSectors: () => asked<{ sectors: number }>("/api/seen/sectors", "DELETE"),
  noSector: (name: string) => asked<{ sectors: number }>(`/api/seen/sectors?name=${part(name)}`, "DELETE"),
  sectorsUrl: "/api/seen/sectors",
  woods: (file: File) => asked<{ woods: number }>(`/api/seen/woods?name=${part(file.name)}`, "POST", file),
  noWoods: () => asked<{ woods: number }>("/api/seen/woods", "DELETE"),
  flightRows: (by: string, below: string, heightM: string, overlap: string) =>
    asked<FlightRows>(`/api/seen/rows?by=${by}&below=${below}&overlap=${overlap}${heightM === "" ? "" : `&height_m=${part(heightM)}`}`),
  gapsUrl: (kind: string, by: string, below: string) => `/api/seen/gaps/${kind}?by=${by}&below=${below}`,
  seenAt: (lat: number, lon: number) => asked<SeenAt>(`/api/seen/at?lat=${lat}&lon=${lon}`),
  seenPixel: (at: SeenPicture, lat: number, lon: number) =>
    asked<{ u_px: number; v_px: number }>(`${frameUrl(at.vehicle, at.session, at.frame, "pixel")}&lat=${lat}&lon=${lon}`),
  /** All of one of the server's views: a list, or of each thing its own. */
  all: async <K extends keyof News>(what: K): Promise<News[K][]> =>
    (await asked<Record<K, (News[K] | News[K][])[]>>(`/api/${what}`))[what].flat() as News[K][],
  follow: (body: ClickBody) => asked<{ vehicle: string; track: number; frame: number }>("/api/tracks", "POST", body),
  endTrack: (vehicle: string, track: number) => asked<unknown>(`/api/tracks/${part(vehicle)}/${track}`, "DELETE"),
  look: (body: ClickBody) => asked<LookOffer>("/api/look", "POST", body),
  lookCircle: (body: { vehicle: string; ticket: string }) => asked<LookOffer>("/api/look/circle", "POST", body),
  lookConfirm: (body: { vehicle: string; ticket: string; waited_s: number }) => asked<{ may_circle?: boolean }>("/api/look/confirm", "POST", body),
  lookAhead: (vehicle: string) => asked<unknown>("/api/look/ahead", "POST", { vehicle }),
  area: () => asked<AreaState>("/api/tiles"),
  planArea: (view: AreaView) => asked<AreaPlan>("/api/tiles/plan", "POST", view),
  downloadArea: (body: AreaView & { deepest: number }) => asked<AreaState>("/api/tiles/download", "POST", body),
  cancelArea: () => asked<AreaState>("/api/tiles/download", "DELETE"),
  fire: (minutes: string) => asked<FireReply>(`/api/fire?minutes=${minutes}`),
  confirmSpot: (spot: number, body: { category: string; who: string }) => asked<Pin>(`/api/spots/${spot}/confirm`, "POST", body),
  dismissSpot: (spot: number, who: string) => asked<unknown>(`/api/spots/${spot}/dismiss`, "POST", { who }),
  spotCropUrl: (spot: FoundSpot) => `/api/spots/${spot.spot}/crop?v=${spot.best.frame}`,
  pins: () => asked<{ pins: Pin[]; ties: Tie[]; revision: number }>("/api/pins"),
  addPin: (body: { click: ClickBody; category: string; who: string }) => asked<PinReply>("/api/pins", "POST", body, [422]),
  addClick: (id: string, body: ClickBody & { who: string; anyway?: boolean }) => asked<PinReply>(`/api/pins/${part(id)}/clicks`, "POST", body, [409, 422]),
  typedPin: (body: { lat_deg: number; lon_deg: number; sigma_m?: number; seen_utc?: string; name: string; category: string; who: string }) =>
    asked<PinReply>("/api/pins", "POST", body),
  place: (body: ClickBody & { measured?: boolean }) => asked<PlaceReply>("/api/place", "POST", body),
  coordinate: (text: string) => asked<CoordinateReply>(`/api/coordinate?text=${part(text)}`),
  coordinateTexts: (lat: number, lon: number, ce90: number | null) => asked<Record<string, string>>(`/api/coordinate/texts?lat=${lat}&lon=${lon}${ce90 === null ? "" : `&ce90=${ce90}`}`),
  importFile: (file: File, who: string) =>
    asked<{ imported: number; known: number; left_out: number; bad: string[] }>(`/api/import?name=${part(file.name)}&who=${part(who)}`, "POST", file),
  removeClick: (id: string, click: string, who: string) =>
    asked<Pin>(`/api/pins/${part(id)}/clicks/${part(click)}?who=${part(who)}`, "DELETE"),
  editPin: (id: string, body: { name?: string; note?: string; category?: string; who: string }) =>
    asked<Pin>(`/api/pins/${part(id)}`, "PATCH", body),
  deletePin: (id: string, who: string) => asked<unknown>(`/api/pins/${part(id)}?who=${part(who)}`, "DELETE"),
  cropUrl: (id: string, version: string) => `/api/pins/${part(id)}/crop?v=${part(version)}`,
  seen: (id: string) => asked<Seen[]>(`/api/pins/${part(id)}/seen`),
  handoff: (id: string, from: string, crs: string) => asked<Handoff>(`/api/pins/${part(id)}/handoff?from=${part(from)}&crs=${part(crs)}`),
  packageUrl: (id: string) => `/api/pins/${part(id)}/package.zip`,
  sendToTak: (id: string) => asked<{ sent: string }>(`/api/pins/${part(id)}/tak`, "POST"),
  qrUrl: (id: string) => `/api/pins/${part(id)}/qr.svg`,
  measure: (from: string, to: string) => asked<Record<string, number | string | null>>(`/api/measure?from=${part(from)}&to=${part(to)}`),
  undo: (who: string) => asked<{ undone: string | null }>("/api/undo", "POST", { who }),
  redo: (who: string) => asked<{ redone: string | null }>("/api/redo", "POST", { who }),
  addTie: (body: unknown) =>
    asked<{ tie: Tie | null; reason?: string; answer?: { reason?: string; advice?: string } }>("/api/ties", "POST", body, [409, 422]),
  deleteTie: (id: string, who: string) => asked<unknown>(`/api/ties/${part(id)}?who=${part(who)}`, "DELETE"),
};

/** Events from now on; after a gap `onOpen` is called again, and everything must be fetched again. */
export function listen(onEvent: (event: ServerEvent) => void, onOpen: () => void, onLost: () => void): void {
  let pause = 250;
  const connect = (): void => {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/events`);
    socket.onopen = () => { pause = 250; onOpen(); };
    socket.onmessage = (message) => onEvent(JSON.parse(String(message.data)) as ServerEvent);
    socket.onclose = () => {
      onLost();
      setTimeout(connect, pause);
      pause = Math.min(pause * 2, 4000);
    };
  };
  connect();
}
