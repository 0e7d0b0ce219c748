"""The server: the API, the events, the page and its tiles, behind the guard."""

from __future__ import annotations

import asyncio
import contextlib
import html
import re
from collections.abc import AsyncIterator
from typing import Any

from fastapi import FastAPI, HTTPException, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse
from starlette.types import ASGIApp

from contract.errors import PointclickError
from ground.web.api_pins import pins_router
from ground.web.api_vehicles import row_json, vehicle_json, vehicles_router
from ground.web.desk import Desk, NotThere
from ground.web.guard import Guard, Rules
from ground.web.handoff import handoff_router
from ground.web.tiles import MbTiles

WATCH_S = 0.04  # between looks at the source: a new picture is told of so soon
STATUS_S = 1.0
SPARE_ROWS, MOST_ROWS = 8, 500
_MEDIA = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".webmanifest": "application/manifest+json",
}
_ASSET = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*")


def create_app(desk: Desk, rules: Rules) -> ASGIApp:
    """An ASGI application. The desk stays the caller's to close."""

    @contextlib.asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        desk.hub.start()
        watching = asyncio.create_task(_watch(desk))
        yield
        watching.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await watching

    app = FastAPI(
        title="pointclick ground station",
        version="1",
        lifespan=life,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
        description="Pictures, clicks and pins. Angles in degrees (WGS84), lengths in metres, times in UTC.",
    )
    for router in (vehicles_router(desk), pins_router(desk), handoff_router(desk)):
        app.include_router(router, prefix="/api")

    @app.exception_handler(PointclickError)
    async def refused(_: Request, error: PointclickError) -> JSONResponse:
        return JSONResponse({"detail": str(error)}, status_code=404 if isinstance(error, NotThere) else 422)

    @app.websocket("/api/events")
    async def events(socket: WebSocket) -> None:
        queue = desk.hub.join()
        if queue is None:
            await socket.close(1013, "too many browsers")
            return
        await socket.accept()

        async def send() -> None:
            while True:
                await socket.send_text(await queue.get())

        sending = asyncio.create_task(send())
        try:
            while True:
                await socket.receive_text()
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            desk.hub.leave(queue)
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sending

    @app.get("/api", include_in_schema=False)
    def about() -> HTMLResponse:
        return HTMLResponse(_api_page(app.openapi()))

    _add_tiles(app, desk)

    @app.get("/{path:path}", include_in_schema=False)
    def asset(path: str, request: Request) -> Response:
        name = path or "index.html"
        file = desk.static / name
        if _ASSET.fullmatch(name) is None or not file.is_file():
            return PlainTextResponse("there is nothing here\n", status_code=404)
        # Every build names its files anew but for the page itself.
        is_named_by_content = re.search(r"-[A-Z0-9]{8}\.", name) is not None
        headers = {"cache-control": "public, max-age=31536000, immutable" if is_named_by_content else "no-cache"}
        media = _MEDIA.get(file.suffix, "application/octet-stream")
        packed = file.with_name(name + ".gz")
        if packed.is_file() and "gzip" in request.headers.get("accept-encoding", ""):
            return FileResponse(
                packed, media_type=media, headers={**headers, "content-encoding": "gzip", "vary": "accept-encoding"}
            )
        return FileResponse(file, media_type=media, headers=headers)

    return Guard(app, rules)


def _add_tiles(app: FastAPI, desk: Desk) -> None:
    tiles = desk.tiles
    if tiles is None or tiles.path is None:
        return
    if tiles.kind == "pmtiles":
        path = tiles.path

        @app.get("/tiles/base.pmtiles", include_in_schema=False)
        def base() -> FileResponse:
            return FileResponse(path, media_type="application/octet-stream")

    else:
        file = MbTiles(tiles)

        @app.get("/tiles/{z}/{x}/{y}", include_in_schema=False)
        def tile(z: int, x: int, y: int) -> Response:
            found = file.tile(z, x, y)
            if found is None:
                raise HTTPException(404, "no tile there")
            headers = {"content-encoding": "gzip"} if found[1] else {}
            return Response(found[0], media_type=file.media_type, headers=headers)


async def _watch(desk: Desk) -> None:
    """Tell browsers of new pictures at once, and of everybody's state once a second."""
    versions: dict[str, int] = {}
    status_in_s = 0.0
    while True:
        status_in_s -= WATCH_S
        changed = []
        for vehicle in desk.source.vehicles():
            version = desk.source.version(vehicle)
            before = versions.get(vehicle)
            if before != version:
                versions[vehicle] = version
                # As many as came since, and some before: of sets that come out of order, or better.
                changed.append((vehicle, SPARE_ROWS + min(max(version - (before or 0), 0), MOST_ROWS)))
        if len(desk.hub):
            for vehicle, count in changed:
                rows = await asyncio.to_thread(_newest_rows, desk, vehicle, count)
                desk.hub.tell({"type": "frames", "vehicle": vehicle, "frames": rows})
            if status_in_s <= 0.0:
                status_in_s = STATUS_S
                if await asyncio.to_thread(desk.changed_elsewhere):
                    desk.hub.tell({"type": "pins"})
                desk.hub.tell(await asyncio.to_thread(_status, desk))
        await asyncio.sleep(WATCH_S)


def _newest_rows(desk: Desk, vehicle: str, count: int) -> list[dict[str, Any]]:
    """The last pictures: what browsers lack."""
    return [row_json(row) for row in desk.source.frames(vehicle, count)]


def _status(desk: Desk) -> dict[str, Any]:
    vehicles = [vehicle_json(desk, name) for name in desk.source.vehicles()]
    return {"type": "status", "vehicles": vehicles, "damage": desk.source.damage()[:5], "sharing": desk.sharing_words()}


def _api_page(schema: dict[str, Any]) -> str:
    """The API as a page without scripts: one row a route."""
    rows = []
    for path, methods in schema["paths"].items():
        for method, about in methods.items():
            cells = (method.upper(), path, str(about.get("summary", "")))
            rows.append("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>API of pc-ground web</title>'
        "<h1>API of pc-ground web</h1><p>The same for programs: "
        '<a href="/api/openapi.json">/api/openapi.json</a>. Events: WebSocket at /api/events.</p>'
        f"<table><tr><th>method</th><th>path</th><th>what</th></tr>{''.join(rows)}</table></html>"
    )
