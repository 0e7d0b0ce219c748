"""One table of everything that crosses the link: key expression, payload, rate, quality of service.

`{vehicle}` is one chunk of a zenoh key. Publisher and ground take the quality of service from here: a topic's own is
that of its publication, and QUERY that of a query and of its answer (docs/wire-format.md, section 8).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ANY_VEHICLE = "*"
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_FORBIDDEN = frozenset("/*$?#")


@dataclass(frozen=True)
class Qos:
    """Quality of service, by the names that zenoh's enumerations have. `express`: never held back to fill a batch."""

    reliability: Literal["BEST_EFFORT", "RELIABLE"]
    congestion_control: Literal["DROP", "BLOCK"]
    priority: Literal["DATA_HIGH", "DATA", "DATA_LOW"]
    express: bool


@dataclass(frozen=True)
class Topic:
    """One key and what travels on it. `max_rate_hz` is a limit that the sender keeps, not a measured rate."""

    template: str
    payload: str
    max_rate_hz: float
    qos: Qos

    def key(self, vehicle: str) -> str:
        """The key of one vehicle, or of all with ANY_VEHICLE. Raises ValueError for a name no key can hold."""
        if vehicle != ANY_VEHICLE and (not vehicle or _FORBIDDEN & set(vehicle)):
            raise ValueError(f"vehicle {vehicle!r} must be a name without any of {' '.join(sorted(_FORBIDDEN))}")
        return self.template.format(vehicle=vehicle)

    def vehicle(self, key: str) -> str:
        """The vehicle of one of this topic's keys. Raises ValueError if it is none."""
        before, after = self.template.split("{vehicle}")
        name = key[len(before) : len(key) - len(after)]
        if not name or self.template.format(vehicle=name) != key:
            raise ValueError(f"{key!r} is not a key of {self.template!r}")
        return name


# A message is small, complete in itself and is soon followed by a newer one: never wait for an old one to get through.
LATEST_ONLY = Qos("BEST_EFFORT", "DROP", "DATA", express=True)
# Of a query and its answer, both sent once: they wait in the queue, and zenoh sends them again if they are lost. It
# gives the answer the quality of its query.
QUERY = Qos("RELIABLE", "BLOCK", "DATA", express=False)

FEATURES = Topic("pc/{vehicle}/features", "pointclick set, docs/wire-format.md", 30.0, LATEST_ONLY)

# How the aircraft is, for people and for dashboards: small, once a second.
STATUS = Topic("pc/{vehicle}/status", "JSON, docs/wire-format.md section 10", 1.0, LATEST_ONLY)

# Small images of keyframes, each in several packets; only what sets, status and replies leave of the bit rate.
PICTURE = Topic(
    "pc/{vehicle}/picture",
    "a piece of an image, docs/wire-format.md section 11",
    100.0,
    Qos("BEST_EFFORT", "DROP", "DATA_LOW", express=True),
)

# Where the things are that are followed: all tracks in one packet.
TRACKS = Topic("pc/{vehicle}/tracks", "reports of tracks, docs/wire-format.md section 14", 2.0, LATEST_ONLY)

# What is hotter than the ground about it: all spots of a picture in one packet.
SPOTS = Topic("pc/{vehicle}/spots", "spots of a picture, docs/wire-format.md section 15", 2.0, LATEST_ONLY)

TOPICS: tuple[Topic, ...] = (FEATURES, STATUS, PICTURE, TRACKS, SPOTS)

# Queries alone, which begin and end tracks: a key of its own, so that rights can name it.
FOLLOW = Topic("pc/{vehicle}/follow", "JSON, docs/wire-format.md section 14", 0.0, QUERY)

# A liveliness token, there as long as the aircraft is: who is there is known without a message of anybody's.
ALIVE = Topic("pc/{vehicle}/alive", "none", 0.0, QUERY)

# Of ground servers that share pins: pc/pins/<server>/<what>.
PINS = "pc/pins"


def of_vehicle(vehicle: str) -> str:
    """All keys of one vehicle, or of all with ANY_VEHICLE. Raises ValueError for a name no key can hold."""
    return Topic("pc/{vehicle}/*", "any", 0.0, LATEST_ONLY).key(vehicle)


# Parameters of a query on FEATURES. None: the newest answerable set.
FRAME_PARAMETER = "frame"
TIME_PARAMETER = "time"
# With either of them: how many seconds the ground waits for the answer, if not ANSWER_TIMEOUT_S. A picture that was
# taken and has no set yet is answered when it has one.
WAIT_PARAMETER = "wait"
ANSWER_TIMEOUT_S = 3.0
# With any of these, or none: the pixel that is to be measured by itself, columns and rows.
PIXEL_PARAMETERS = "u", "v"
# Parameter of a query on STATUS: all other state of the daemon, for `pc-onboard doctor`.
DETAIL_PARAMETER = "detail"
# How far a picture's capture may be from the `time` asked for.
TIME_TOLERANCE_S = 0.5
