"""`python -m tests.onboard.telemetry.fuzz [COUNT] [SEED]`: as many damaged packets and sentences.

Too long for every test run (a million take some minutes); prints how many, how fast, and what was made of them. Ends
with a traceback at the first that anything raises on, after naming its seed.
"""

import math
import random
import sys
import time
from collections import Counter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.config.schema import Config, parse_config
from onboard.events.types import NavEvent, PositionFix
from onboard.navigation.navigator import Navigation
from onboard.telemetry.mavlink_events import WANTED
from onboard.telemetry.mavlink_framing import Framer
from onboard.telemetry.mavlink_session import Autopilot
from onboard.telemetry.mavsdk_source import from_json
from onboard.telemetry.nmea_source import NmeaReceiver
from tests.onboard.telemetry.sentences import burst, sentence

SPELL = 200  # inputs before everything begins again
KINDS = [mavlink.mavlink_map[number] for number in (*sorted(WANTED), 22, 77, 111)]
EDGES = (0, 1, 0x7F, 0x80, 0xFF)


def packet(rng: random.Random, packer: Any, boot_ms: int) -> bytes:
    """A packet of a kind we listen to: nonsense or edge values within, a right checksum, and sometimes damage."""
    kind = rng.choice(KINDS)
    size = kind.unpacker.size
    payload = bytes(rng.choice(EDGES) for _ in range(size)) if rng.random() < 0.5 else rng.randbytes(size)
    if rng.random() < 0.97 and "time_boot_ms" in kind.fieldnames:  # or every message would be a reboot
        at = 8 if kind.msgname == "SYSTEM_TIME" else 0  # fields travel by size
        payload = payload[:at] + boot_ms.to_bytes(4, "little") + payload[at + 4 :]
    message = mavlink.MAVLink_message(kind.id, kind.msgname)
    out = bytearray(message._pack(packer, kind.crc_extra, payload, force_mavlink1=rng.random() < 0.1 and kind.id < 256))
    for _ in range(rng.choice((0, 0, 0, 1, 3))):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out[: rng.randrange(len(out))] if rng.random() < 0.05 else out)


def line(rng: random.Random) -> bytes:
    """A sentence with fields changed, mostly with a right checksum."""
    chosen = rng.choice(burst(rng.uniform(0.0, 86_400.0)).split(b"\r\n")[:-1]).decode()[1:].partition("*")[0].split(",")
    for _ in range(rng.randrange(4)):
        chosen[rng.randrange(1, len(chosen))] = rng.choice(
            ("", "-1", "nan", "inf", "1e999", "x", "99999999", "0", "61")
        )
    out = sentence(",".join(chosen))
    return out if rng.random() < 0.8 else rng.randbytes(rng.randrange(1, 90)) + out[rng.randrange(len(out)) :]


def judge(event: NavEvent, navigation: Navigation) -> None:
    """What any event must be, and that navigation takes it."""
    assert abs(event.stamp_ns) < 2**63
    if isinstance(event, PositionFix):
        assert abs(event.lat_deg) <= 90.0 and abs(event.lon_deg) <= 180.0 and math.isfinite(event.height_amsl_m)
    navigation.add(event)


def spell(rng: random.Random, counts: Counter[str]) -> None:
    """One autopilot and one receiver, from their first byte on."""
    config = parse_config(f"[telemetry]\nsystem = {rng.choice((0, 1))}")
    autopilot, framer, packer = Autopilot(config), Framer(mavlink.MAVLink(None)), mavlink.MAVLink(None, 1, 1)
    receiver, navigations, now = NmeaReceiver(), [Navigation(Config()) for _ in range(2)], 10**18
    for _ in range(SPELL):
        now += rng.choice((10**6, 10**7, 10**8))
        if rng.random() < 0.25:
            events = receiver.take(line(rng), now)
            navigation = navigations[0]
        else:
            events, navigation = [], navigations[1]
            for message in framer.feed(packet(rng, packer, (now - 10**18) // 10**6)):
                counts[message.get_type()] += 1
                events += autopilot.receive(message, now)
        for event in events:
            counts[type(event).__name__] += 1
            judge(event, navigation)
        assert len(autopilot.due(now)) < 50
        autopilot.health(now)
        for navigation in navigations:
            navigation.state_at(now - rng.randrange(10**9))
        if rng.random() < 0.05:
            from_json(
                rng.choice(KINDS).msgname, 1, 1, rng.choice(('{"lat": 1e99}', "[]", "{", '{"q": [null]}', "null"))
            )


def main() -> None:
    count, seed = (int(word) for word in [*sys.argv[1:], *("1000000", "0")[len(sys.argv) - 1 :]])
    counts: Counter[str] = Counter()
    began = time.monotonic()
    for i in range(count // SPELL):
        try:
            spell(random.Random(seed + i), counts)
        except BaseException:
            print(f"seed {seed + i}", file=sys.stderr)
            raise
    print(f"{count} inputs in {time.monotonic() - began:.0f} s: {dict(counts.most_common())}")


if __name__ == "__main__":
    main()
