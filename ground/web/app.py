"""The server: the API, the events, the page and its tiles, behind the guard."""

from __future__ import annotations

import asyncio
import contextlib
import html
import re
from collections.abc import AsyncIterator
from typing import Any

from fastapi import FastAPI, HTTPException, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp

from contract.errors import PointclickError
from ground.web import (
    api_import,
    api_look,
    api_pins,
    api_seen,
    api_spots,
    api_tiles,
    api_tracks,
    api_vehicles,
    handoff,
    ogc,
    report,
    tak,
)
from ground.web.context import NotThere, ServerContext
from ground.web.dependency import Context
from ground.web.guard import Guard, Rules
from ground.web.tile_area import TileArea
from ground.web.tile_fetch import image_format
from ground.web.tiles import MEDIA, MbTiles
from ground.web.watch import Watch

_MEDIA = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".webmanifest": "application/manifest+json",
}
_ASSET = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*")


def create_app(context: ServerContext, rules: Rules) -> ASGIApp:
    """An ASGI application. The caller closes the server context."""

    @contextlib.asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        context.hub.start()
        watch = Watch(context)
        yield
        await asyncio.to_thread(watch.close)
        await asyncio.to_thread(context.found_map.close)
        await asyncio.to_thread(context.seen_map.close)
        if context.area is not None:
            await asyncio.to_thread(context.area.close)

    app = FastAPI(
        title="pointclick ground station",
        version="1",
        lifespan=life,
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/openapi.json",
        description="Pictures, clicks and pins. Angles in degrees (WGS84), lengths in metres, times in UTC.",
    )
    app.state.context = context
    looks = api_vehicles, api_seen, api_tracks, api_look, api_spots, api_tiles
    for part in (*looks, api_pins, handoff, api_import, report, tak):
        app.include_router(part.router, prefix="/api")
    app.include_router(ogc.router, prefix="/ogc")

    @app.exception_handler(PointclickError)
    async def refused(_: Request, error: PointclickError) -> JSONResponse:
        return JSONResponse({"detail": str(error)}, status_code=404 if isinstance(error, NotThere) else 422)

    @app.exception_handler(RequestValidationError)
    async def no_such_body(_: Request, error: RequestValidationError) -> JSONResponse:
        return JSONResponse({"detail": _in_a_line(error)}, status_code=422)

    app.websocket("/api/events")(_events)

    @app.get("/api", include_in_schema=False)
    def about() -> HTMLResponse:
        return HTMLResponse(_api_page(app.openapi()))

    _add_tiles(app, context)

    app.get("/{path:path}", include_in_schema=False)(_asset)
    return Guard(app, rules)


async def _events(context: Context, socket: WebSocket) -> None:
    queue = context.hub.join()
    if queue is None:
        await socket.close(1013, "too many browsers")
        return
    await socket.accept()

    async def send() -> None:
        while True:
            await socket.send_text(await queue.get())

    async def receive() -> None:
        while True:
            await socket.receive_text()

    # One that ends, for any reason, ends the other: the browser notices and connects again.
    both = asyncio.create_task(send()), asyncio.create_task(receive())
    try:
        await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
    finally:
        context.hub.leave(queue)
        for task in both:
            task.cancel()
        await asyncio.wait(both)
    for task in both:
        error = None if task.cancelled() else task.exception()
        if error is not None and not isinstance(error, (WebSocketDisconnect, RuntimeError)):
            raise error


def _asset(context: Context, path: str, request: Request) -> Response:
    name = path or "index.html"
    file = context.static / name
    if _ASSET.fullmatch(name) is None or not file.is_file():
        return PlainTextResponse("there is nothing here\n", status_code=404)
    # Every build gives its files new names, except the page itself.
    is_named_by_content = re.search(r"-[A-Z0-9]{8}\.", name) is not None
    headers = {"cache-control": "public, max-age=31536000, immutable" if is_named_by_content else "no-cache"}
    media = _MEDIA.get(file.suffix, "application/octet-stream")
    packed = file.with_name(name + ".gz")
    if packed.is_file() and "gzip" in request.headers.get("accept-encoding", ""):
        return FileResponse(
            packed, media_type=media, headers={**headers, "content-encoding": "gzip", "vary": "accept-encoding"}
        )
    return FileResponse(file, media_type=media, headers=headers)


def _in_a_line(error: RequestValidationError) -> str:
    """The fault of a request: which field, and why, without what was sent."""
    wrong = error.errors()
    if wrong[0]["type"] == "json_invalid":
        return "the body is no JSON"
    where = ".".join(str(part) for part in wrong[0]["loc"] if part not in ("body", "query", "path"))
    more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
    text = f"{where[:80]}: {wrong[0]['msg']}{more}" if where else f"{wrong[0]['msg']}{more}"
    return text.encode("ascii", "replace").decode()


def _add_tiles(app: FastAPI, context: ServerContext) -> None:
    tiles = context.tiles
    if context.area is not None:
        _add_area(app, context.area)
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


def _add_area(app: FastAPI, area: TileArea) -> None:
    """Tiles out of what was downloaded; of what was not, the browser is sent to the address."""

    @app.get("/tiles/{z}/{x}/{y}", include_in_schema=False)
    def kept(z: int, x: int, y: int) -> Response:
        found = area.tile(z, x, y)
        if found is not None:
            kind = image_format(found)
            headers = {"content-encoding": "gzip"} if kind == "pbf" else {}
            return Response(found, media_type=MEDIA[kind], headers=headers)
        url = area.elsewhere(z, x, y)
        if url is None:
            raise HTTPException(404, "no tile there")
        return RedirectResponse(url, headers={"cache-control": "no-store"})


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
