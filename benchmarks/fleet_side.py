"""One side of `benchmarks.fleet`: a fleet's aircraft, or its operators, in a process of its own until its input ends.

    python -m benchmarks.fleet_side aircraft|operators NAME,NAME... --endpoint E --keys DIR --out FILE.npz

What was said or received is written at the end, a row each: operator (0 for aircraft), aircraft, frame, capture and
arrival in nanoseconds of this machine's clock. An aircraft named with `!` flaps: it leaves and comes back each second
from the line `flap` on its input to the line `steady`.
"""

from __future__ import annotations

import argparse
import dataclasses
import struct
import sys
import threading
import time
from array import array
from pathlib import Path

import cv2
import numpy as np
import zenoh

from contract.errors import WireError
from contract.feature_set import FeatureSet
from contract.link_config import Tls, link_config
from contract.picture import ImageFormat, LinkPicture
from contract.topics import FEATURES, PICTURE, STATUS
from contract.vehicle_status import VehicleStatus, encode_status
from onboard.link.publisher import Publisher, Rate
from tests.contract.sets import plain_set

SET_PERIOD_S, PICTURE_PERIOD_S = 0.5, 2.0
RATE = Rate(max_bit_rate=256_000.0, max_rate_hz=5.0)
FLAP_S = 1.0
HEAD = struct.Struct("<7xII2xQ")  # session, frame, capture time: docs/wire-format.md, section 2


class Aircraft:
    """Sets at 2 Hz with a status a second, and pictures if `has_pictures`; a thread."""

    def __init__(self, name: str, at: Way, made: FeatureSet, has_pictures: bool, received: array[int]) -> None:
        self.name = name
        self._at, self._set, self._has_pictures, self._said = at, made, has_pictures, received
        self._number = int(name.rpartition("-")[2])
        self.ended, self.flaps = threading.Event(), threading.Event()
        self._frame = 0
        coarse = np.random.default_rng(self._number).integers(40, 220, (12, 16), dtype=np.uint8)
        sampled = cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC)
        self._jpeg = cv2.imencode(".jpg", sampled, [cv2.IMWRITE_JPEG_QUALITY, 50])[1].tobytes()  # some 6 kB
        self.thread = threading.Thread(target=self._fly)
        self.thread.start()

    def _fly(self) -> None:
        while not self.ended.is_set():
            with Publisher(self.name, [], [self._at.endpoint], rate=RATE, tls=self._at.tls(self.name)) as publisher:
                since_s = time.monotonic()
                while not self.ended.wait(SET_PERIOD_S * (0.98 + 0.0004 * self._number)):  # not all at the same moment
                    self._publish(publisher)
                    if self.flaps.is_set() and time.monotonic() - since_s > FLAP_S:
                        break

    def _publish(self, publisher: Publisher) -> None:
        now_ns = time.time_ns()
        made = dataclasses.replace(self._set, vehicle=self.name, frame=self._frame, capture_unix_ns=now_ns)
        publisher.publish(made)
        self._said.extend((0, self._number, self._frame, now_ns, now_ns))
        if self._frame % 2 == 0:
            publisher.publish_status(encode_status(VehicleStatus(now_ns / 1e9, made.session, "ok")), b"{}")
        if self._has_pictures and self._frame % round(PICTURE_PERIOD_S / SET_PERIOD_S) == 0:
            room = publisher.picture_room()
            if room > 0:
                picture = LinkPicture(
                    self.name, made.session, self._frame, now_ns, 320, 240, ImageFormat.JPEG, self._jpeg
                )
                publisher.send_picture(picture, room)
        self._frame += 1


@dataclasses.dataclass(frozen=True)
class Way:
    """The connection to the router."""

    endpoint: str
    keys: Path

    def tls(self, name: str) -> Tls:
        """One's own."""
        return Tls.in_folder(self.keys / name)


class Operator:
    """Listens to all aircraft's sets, statuses and pictures, and notes the sets' heads without reading them whole."""

    def __init__(self, name: str, at: Way, received: array[int]) -> None:
        self._number, self._received = int(name.rpartition("-")[2]), received
        self._lock = threading.Lock()
        config = link_config("peer", connect=[at.endpoint], tls=at.tls(name))
        self.session = zenoh.open(zenoh.Config.from_json5(config))
        self._declared = [
            self.session.declare_subscriber(FEATURES.key("*"), self._take),
            self.session.declare_subscriber(STATUS.key("*"), lambda _: None),
            self.session.declare_subscriber(PICTURE.key("*"), lambda _: None),
        ]

    def _take(self, sample: zenoh.Sample) -> None:
        at_ns, payload = time.time_ns(), sample.payload.to_bytes()
        if len(payload) < HEAD.size:
            raise WireError(f"a set of {len(payload)} bytes")
        _, frame, capture_ns = HEAD.unpack_from(payload)
        vehicle = int(str(sample.key_expr).split("/")[1].rpartition("-")[2])
        with self._lock:
            self._received.extend((self._number, vehicle, frame, capture_ns, at_ns))


def main() -> int:
    """Until the input ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("role", choices=["aircraft", "operators"])
    parser.add_argument("names")
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--keys", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--pictures", type=int, default=0, help="aircraft that send pictures, the first ones")
    args = parser.parse_args()
    at, rows = Way(args.endpoint, args.keys), array("q")
    names = args.names.split(",")
    operators: list[Operator] = []
    fleet: list[Aircraft] = []
    if args.role == "operators":
        operators = [Operator(name, at, rows) for name in names]
    else:
        made = plain_set(100)
        fleet = [Aircraft(name.rstrip("!"), at, made, k < args.pictures, rows) for k, name in enumerate(names)]
    print("ready", flush=True)
    for line in sys.stdin:
        for one in (one for one, name in zip(fleet, names, strict=True) if name.endswith("!")):
            (one.flaps.set if line.strip() == "flap" else one.flaps.clear)()
    assert all(one.thread.is_alive() for one in fleet)
    for one in fleet:
        one.ended.set()
    for one in fleet:
        one.thread.join()
    for operator in operators:
        operator.session.close()  # type: ignore[no-untyped-call]
    np.save(args.out, np.array(rows, np.int64).reshape(-1, 5))
    return 0


if __name__ == "__main__":
    sys.exit(main())
