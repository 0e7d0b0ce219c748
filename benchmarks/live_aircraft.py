"""An aircraft on a link of this machine: simulated sets five times a second, and their pictures where there is room."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import cv2

from contract.picture import ImageFormat, LinkPicture
from contract.vehicle_status import VehicleStatus, encode_status
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.ports import free_endpoint
from tests.web.rendered import rendered_picture, rendered_set

PERIOD_S = 0.2


class Aircraft:
    """Publishes in a thread until it is closed."""

    def __init__(self, name: str) -> None:
        self.name, self.endpoint = name, free_endpoint()
        self._publisher = Publisher(name, listen=[self.endpoint], rate=Rate(5e6, 1.0, 10.0))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._fly, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the flight and its publisher."""
        self._ended.set()
        self._thread.join(5.0)
        self._publisher.close()

    def _fly(self) -> None:
        frame, began_ns = 0, time.time_ns()
        session = began_ns // 1_000_000_000
        while not self._ended.wait(PERIOD_S):
            at_ns = began_ns + round(frame * PERIOD_S * 1e9)
            made = replace(
                rendered_set(frame % 200), vehicle=self.name, session=session, frame=frame, capture_unix_ns=at_ns
            )
            self._publisher.publish(made)
            if frame % 5 == 0:
                status = VehicleStatus(at_ns / 1e9, session, "ok", tracks=len(made), cpu_c=61.0)
                self._publisher.publish_status(encode_status(status), b"")
                self._send_picture(session, frame, at_ns)
            frame += 1

    def _send_picture(self, session: int, frame: int, at_ns: int) -> None:
        room = self._publisher.picture_room()
        if room > 0:
            content = cv2.imencode(".jpg", rendered_picture(frame % 50))[1].tobytes()
            picture = LinkPicture(self.name, session, frame, at_ns, 640, 480, ImageFormat.JPEG, content)
            self._publisher.send_picture(picture, room)
