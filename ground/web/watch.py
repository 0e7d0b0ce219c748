"""Reports new pictures and tracks to browsers at once, and all vehicles' state and the pins once a second."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from contract.errors import PointclickError
from ground.watched_thread import WatchedThread
from ground.web.api_spots import spots_json
from ground.web.api_tracks import track_json
from ground.web.api_vehicles import row_json, vehicle_json
from ground.web.context import ServerContext
from ground.web.source import MOST_ROWS, SPARE_ROWS, PageView

PICTURES_S = 0.04  # between checks of the source: a new picture is reported within this time
STATUS_S = 1.0


class News(NamedTuple):
    """The form of a view's news to browsers, an event of the topic's name: looked for every `period_s`."""

    period_s: float
    to_json: Callable[[ServerContext, list[Any]], list[dict[str, Any]]]


# By the names in `Views`.
NEWS: dict[str, News] = {
    "tracks": News(0.1, lambda _, reports: [track_json(report) for report in reports]),
    "spots": News(0.5, spots_json),
}


class Watch:
    """Threads of their own: a fault of one leaves the others' events. What is wrong with them is in the status."""

    def __init__(self, context: ServerContext) -> None:
        self._context = context
        self._versions: dict[str, int] = {}  # of each vehicle's pictures, as browsers have them
        views = vars(context.source.views)
        self._known = {name: view.version for name, view in views.items()}
        self._threads = (
            WatchedThread("watch of the pictures", self._send_pictures, PICTURES_S),
            *(
                WatchedThread(f"watch of the {name}", partial(self._send_news, name, view), NEWS[name].period_s)
                for name, view in views.items()
            ),
            WatchedThread("watch of state and pins", self._send_status, STATUS_S),
        )

    def close(self) -> None:
        for thread in self._threads:
            thread.close()

    def _send_pictures(self) -> None:
        failure: Exception | None = None
        for vehicle in self._context.source.vehicles():
            try:
                self._send_pictures_of(vehicle)
            except Exception as error:  # first report the other vehicles' pictures
                failure = error
        if failure is not None:
            raise failure

    def _send_pictures_of(self, vehicle: str) -> None:
        context = self._context
        version, before = context.source.version(vehicle), self._versions.get(vehicle)
        if version == before:
            return
        if version - (before or version) > MOST_ROWS:
            context.hub.send_from_thread({"type": "resync"})  # a journal was read: browsers ask for all of it
        elif len(context.hub):
            # As many as came since, and some before: sets may come out of order, or in a better revision.
            count = SPARE_ROWS + min(max(version - (before or 0), 0), MOST_ROWS)
            rows = [row_json(row) for row in context.source.frames(vehicle, count)]
            context.hub.send_from_thread({"type": "frames", "vehicle": vehicle, "frames": rows})
        self._versions[vehicle] = version

    def _send_news(self, name: str, view: PageView[Any]) -> None:
        context = self._context
        self._known[name], news = view.since(self._known[name])
        if news is None:
            context.hub.send_from_thread({"type": "resync"})  # a journal was read
        elif news and len(context.hub):
            context.hub.send_from_thread({"type": name, name: NEWS[name].to_json(context, news)})

    def _send_status(self) -> None:
        context = self._context
        if not len(context.hub):
            return
        damage = [thread.trouble for thread in self._threads if thread.trouble]
        try:
            if context.changed_elsewhere():
                context.hub.send_from_thread({"type": "pins"})
        except PointclickError as error:  # the state is reported all the same
            damage.append(str(error))
        no_pictures = context.source.no_pictures()
        notes = [no_pictures] if no_pictures else []
        status: dict[str, Any] = {
            "type": "status",
            "vehicles": [vehicle_json(context, name) for name in context.source.vehicles()],
            "damage": [*notes, *damage, *context.source.damage()][:5],
            "sharing": context.sharing_words(),
        }
        context.hub.send_from_thread(status)
