"""The server context, which all requests share: the source, the pins and who gets events of changes."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contract.answer import Fix
from contract.errors import InputError
from ground.cot_sender import Target
from ground.pins.fusion import Contradiction, Fused, Place, between
from ground.pins.model import Pin, PinClick
from ground.pins.places import Places
from ground.pins.store import PinStore
from ground.web.clicks import Clicked, Clicker
from ground.web.crops import Cropper
from ground.web.events import Hub
from ground.web.found_map import FoundMap
from ground.web.pin_json import pin_json, tie_json
from ground.web.seen_map import SeenMap
from ground.web.source import Source
from ground.web.tile_area import TileArea
from ground.web.tiles import Tiles
from ground.web.view import placed_in

if TYPE_CHECKING:
    from ground.pins.sharing import PinSharing


class NotThere(InputError):
    """Nothing goes by that name."""


@dataclass(eq=False)
class ServerContext:
    """One server's state. Its methods are called in the threads of requests."""

    source: Source
    store: PinStore
    static: Path
    tiles: Tiles | None = None
    sharing: PinSharing | None = None  # of the pins with other servers
    tak: Target | None = None  # where a pin is sent that somebody sends
    area: TileArea | None = None  # what was downloaded of the tiles' address; None: they have none, or are one file
    started_unix_s: float = field(default_factory=time.time)

    def __post_init__(self) -> None:
        self.clicker = Clicker(self.source)
        self.places = Places(self.store)
        self.hub = Hub()
        self.seen_map = SeenMap(self.source)
        self.found_map = FoundMap(self.seen_map, self.source)
        self._cropper = Cropper()
        # By the pin's id: the pin and its place as they were, and their JSON.
        self._texts: dict[str, tuple[Pin, Fused, str]] = {}
        self._revision = self.store.revision
        self._lock = threading.Lock()

    def pin_text(self, pin_id: str) -> str:
        """A pin with its place as it is now, as JSON. Raises NotThere if there is none."""
        return self.pins_text([self.pin(pin_id)])[1:-1]

    def pins_text(self, pins: Sequence[Pin]) -> str:
        """Many, as a JSON list. Only those that have changed are written again: there may be ten thousand."""
        texts = []
        for pin, place in zip(pins, self.places.of(pins), strict=True):
            held = self._texts.get(pin.id)
            if held is None or held[0] is not pin or held[1] is not place:
                text = json.dumps(pin_json(pin, place), separators=(",", ":"), allow_nan=False)
                held = self._texts[pin.id] = pin, place, text
            texts.append(held[2])
        return f"[{','.join(texts)}]"

    def ties_json(self) -> list[dict[str, Any]]:
        return [tie_json(tie) for tie in self.store.ties()]

    def pin(self, pin_id: str) -> Pin:
        """Raises NotThere if there is none."""
        try:
            return self.store.pin(pin_id)
        except InputError as error:
            raise NotThere(str(error)) from error

    def pin_click(self, clicked: Clicked, u_px: float, v_px: float, who: str) -> PinClick | None:
        """The part of an answered click that a pin keeps; None of a refusal."""
        if clicked.feature_set is None or not isinstance(clicked.answer, Fix):
            return None
        return PinClick.of(clicked.feature_set, clicked.answer, (u_px, v_px), who=who, locator=clicked.locator)

    def measured_click(self, clicked: Clicked, made: PinClick) -> PinClick:
        """The click of a pin once the aircraft has measured its pixel; where it has not, the same with the reason."""
        assert made.u_px is not None and made.v_px is not None
        found = self.clicker.measured(clicked, made.u_px, made.v_px)
        again = self.pin_click(found, made.u_px, made.v_px, made.who)
        return made if again is None else replace(again, id=made.id, clicked_unix_ns=made.clicked_unix_ns)

    def measure(self, pin_id: str, clicked: Clicked, made: PinClick) -> None:
        """Have a pin's click measured, which takes seconds at most, and put it in the place of the first."""
        again = self.measured_click(clicked, made)
        if again is not made and self.store.measure(pin_id, again) is not None:
            self.changed(pin_id)

    def contradicts(self, pin: Pin, click: PinClick) -> float | None:
        """Distance (m) of a click from a pin that would have no place with it; None if it fits."""
        before, after = self.places.place(pin), self.places.with_click(pin, click)
        alone = self.places.of_clicks([click])
        if not (isinstance(before, Place) and isinstance(alone, Place) and isinstance(after, Contradiction)):
            return None
        return between(before, alone, None).distance_m

    def crop_of(self, click: PinClick) -> bytes | None:
        """The picture around a click; None where there is no picture."""
        if click.frame is None or click.u_px is None or click.v_px is None:
            return None
        vehicle, session, frame = key = click.vehicle, click.session, click.frame
        found = self.source.feature_set(vehicle, session, frame)
        if found is None:
            return None

        def read() -> bytes | None:
            picture = self.source.picture(vehicle, session, frame)
            return None if picture is None else picture.content

        return self._cropper.crop(key, read, click.u_px, click.v_px, found.camera.size_px)

    def changed(self, pin_id: str | None = None) -> None:
        """One change was made here: report to all browsers the pin as it is now, or that any may have changed.

        Events of concurrent changes may leave in any order. So each has the store's revision, read before the pin: an
        event with a higher one is at least as new, and the page takes no older one after it.
        """
        with self._lock:
            self._revision += 1
        if pin_id is None:
            self.hub.send_from_thread('{"type":"pins"}')
            return
        revision = self.store.revision
        try:
            event = f'{{"type":"pin","revision":{revision},"pin":{self.pin_text(pin_id)}}}'
        except NotThere:
            self._texts.pop(pin_id, None)
            event = json.dumps({"type": "pin_deleted", "revision": revision, "id": pin_id})
        self.hub.send_from_thread(event)

    def changed_elsewhere(self) -> bool:
        """Return whether anything but requests here has changed the pins since the last call. Raises InputError."""
        with self._lock:
            before, self._revision = self._revision, self.store.revision
            return before != self._revision

    def sharing_words(self) -> str:
        """The state of sharing pins with other servers, in words; empty where they are not shared."""
        return "" if self.sharing is None else str(self.sharing.state)

    def seen(self, pin: Pin) -> list[dict[str, Any]]:
        """The pictures that show a pin, with where in them, in capture order."""
        where = pin_json(pin, self.places.place(pin))["place"]
        rows: list[dict[str, Any]] = []
        if where["status"] != "ok":
            return rows
        at = where["lat_deg"], where["lon_deg"], where["height_ellipsoid_m"], where["height_amsl_m"]
        for vehicle in self.source.vehicles():
            for row in self.source.frames(vehicle):
                found = self.source.feature_set(vehicle, row.session, row.frame) if row.status.value == "ok" else None
                uv = None if found is None else placed_in(found, *at)
                if uv is not None:
                    rows.append(
                        {
                            "vehicle": vehicle,
                            "session": row.session,
                            "frame": row.frame,
                            "capture_unix_ns": str(row.capture_unix_ns),
                            "u_px": round(uv[0], 2),
                            "v_px": round(uv[1], 2),
                            "has_picture": row.has_picture,
                        }
                    )
        return rows
