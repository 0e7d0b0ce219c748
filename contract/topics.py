"""One table of everything that crosses the link: key, quality of service, share of the link, place on a disk.

`{vehicle}` is one chunk of a zenoh key. Publisher, recorders, readers and ground go through TOPICS: a new kind of
message is a row here, its codec's row in `contract/wire/message.py` and a view (docs/architecture.md). A topic's
quality of service is that of its publication, and QUERY that of a query and of its answer (docs/wire-format.md, 8).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

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


class Counted(NamedTuple):
    """The words for one and for many messages; the latter is their key in a gap's record, too."""

    one: str
    many: str


@dataclass(frozen=True, eq=False)
class Topic:
    """One key and what travels on it. Its payload is a section of docs/wire-format.md.

    `encoding` is the message encoding of its channel in a recording, `schema` the name of its schema where that is
    JSON. `recorded`: how the aircraft's recording counts them; None where the aircraft records none.
    `share` of the bit rate, at most, belongs to a report: only its newest counts, so one that still waits is replaced
    by the next, and one of an earlier session is dropped. After `patience_s` it goes before new sets.
    """

    template: str
    qos: Qos
    encoding: str = ""
    schema: str = ""
    recorded: Counted | None = None
    share: float = 0.0
    patience_s: float = 0.0

    @property
    def name(self) -> str:
        """The last chunk of the key."""
        return self.template.rpartition("/")[2]

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

FEATURES = Topic("pc/{vehicle}/features", LATEST_ONLY, "pointclick", recorded=Counted("set", "sets"))
# How the aircraft is (10), for people and for dashboards: small, once a second.
STATUS = Topic(
    "pc/{vehicle}/status", LATEST_ONLY,
    "json", "pointclick.Status", Counted("status", "statuses"), share=0.25, patience_s=0.8,
)  # fmt: skip
# Small images of keyframes (11), each in several packets; only what sets, status and replies leave of the bit rate.
PICTURE = Topic(
    "pc/{vehicle}/picture", Qos("BEST_EFFORT", "DROP", "DATA_LOW", express=True), "pointclick picture",
)  # fmt: skip
# Where the things are that are followed (14): all tracks in one packet. The share is one track's twice a second from
# 12 kbit/s on, that of eight from 45.
TRACKS = Topic(
    "pc/{vehicle}/tracks", LATEST_ONLY,
    "pointclick tracks", recorded=Counted("report of tracks", "tracks"), share=0.2, patience_s=0.5,
)  # fmt: skip
# What is hotter than the ground about it (15): all spots of a picture in one packet. The share is two full packets a
# second from 47 kbit/s on.
SPOTS = Topic(
    "pc/{vehicle}/spots", LATEST_ONLY,
    "pointclick spots", recorded=Counted("report of spots", "spots"), share=0.1, patience_s=0.5,
)  # fmt: skip

TOPICS: tuple[Topic, ...] = (FEATURES, STATUS, PICTURE, TRACKS, SPOTS)
REPORTS = tuple(topic for topic in TOPICS if topic.share)

# Queries alone (14), which begin and end tracks: a key of its own, so that rights can name it.
FOLLOW = Topic("pc/{vehicle}/follow", QUERY)

# Queries alone (16), which have the camera look at a place: pc/<vehicle>/look/<name of who asks>, so that a right to
# ask in a name is a right to one key.
LOOK = Topic("pc/{vehicle}/look", QUERY)

# A liveliness token, there as long as the aircraft is: who is there is known without a message of anybody's.
ALIVE = Topic("pc/{vehicle}/alive", QUERY)

# Of ground servers that share pins: pc/pins/<server>/<what>.
PINS = "pc/pins"


def of_vehicle(vehicle: str) -> str:
    """All keys of one vehicle, or of all with ANY_VEHICLE. Raises ValueError for a name no key can hold."""
    return Topic("pc/{vehicle}/*", LATEST_ONLY).key(vehicle)


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
