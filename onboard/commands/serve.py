"""`pc-onboard serve`: answers questions about a recorded flight as the aircraft did, clicked pixels measured.

Over zenoh, by the queries of docs/wire-format.md, section 8; nothing is sent that was not asked for. `pc-ground`
starts it by itself for a recording that holds pictures.
"""

from __future__ import annotations

import argparse
import threading

from contract.track import refused
from onboard.link.publisher import Publisher, Rate
from onboard.service.measure_thread import QuestionThread
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.recorded_pictures import RecordedPictures

RATE = Rate(1e9, 0.2, 30.0)  # no radio is between
FOREVER_S = 1e9
NOT_FOLLOWED = (
    "a recording: to follow something in its pictures, pc-onboard replay SESSION.mcap --track FRAME,U,V --out OUT"
)


def run(arguments: argparse.Namespace, stop: threading.Event) -> int:
    """Answer until `stop` is set. Raises InputError for what is no recording with pictures, LinkError for the link."""
    flight = RecordedFlight.open([arguments.session])
    pictures = RecordedPictures(flight)
    held = len(pictures.sets)
    with (
        Publisher(flight.vehicle, [arguments.listen], history_s=FOREVER_S, history_sets=held, rate=RATE) as link,
        QuestionThread(pictures, rest=0.0) as measured,
    ):
        for payload in pictures.sets.values():
            link.recall(payload)
        link.measure = measured.measure
        link.follow = lambda _: (refused("disabled", NOT_FOLLOWED), True)
        print(
            f"{arguments.session}: {held} sets of {flight.vehicle}, {len(pictures)} to click with their pictures; "
            f"asked at {arguments.listen}",
            flush=True,
        )
        stop.wait()
    return 0
