"""Looking there and circling with a real autopilot: its simulator is sent to look at a place and to circle about it.

    python -m benchmarks.look_there --autopilot CMD --onboard URL --ground ADDRESS [--seconds 90]

CMD starts ArduPilot's simulated plane with one MAVLink port for the companion (URL, as `telemetry.url` has it) and one
for a ground station (ADDRESS, as pymavlink's `mavutil` has it), which has it take off. Without CMD nothing is measured,
and that is said. The place lies some 400 m from the plane and 180 m below it. What the autopilot made of both orders is
held against where the ground station then sees it fly, and against where its gimbal points.
"""

from __future__ import annotations

import argparse
import json
import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pymavlink import mavutil

from benchmarks.machine import table, verdict
from benchmarks.radio import ENDS_WITHIN_S, autopilot, with_simulator
from contract.answer import Fix
from contract.geodesy import LocalFrame, within_180
from contract.locate import Locator
from contract.look import AskCircle, AskLook, ConfirmLook, LookRequest, Offer, parameters_of
from contract.wire.codec import decode, encode
from onboard.config.link import Look
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.service.look_thread import BETWEEN_S, LookThread
from onboard.telemetry.factory import open_telemetry
from onboard.telemetry.pointing import Pointing
from tests.contract.sets import plain_set

PIXEL = (320.0, 240.0)
RADIUS_M = 120.0
BELOW_M = 350.0  # of the set's camera below the plane: its ground lies higher
AWAY_DEG = 0.004, 0.001
HEIGHT_M, WITHIN_S = 45.0, 180.0  # above its home, at which the flight begins, and the patience for it
HEIGHT_GOAL_M, YAW_GOAL_DEG, RADIUS_GOAL = 5.0, 10.0, 0.2  # a plane's guidance flies a circle wider than it is asked to
SETTLED = 1.5  # of the radius: from there on it circles


class Ground:
    """A ground station of the simulator's."""

    def __init__(self, address: str) -> None:
        self.link = mavutil.mavlink_connection(address, retries=60)
        self.link.wait_heartbeat()
        self.link.target_component = mavutil.mavlink.MAV_COMP_ID_AUTOPILOT1  # whoever sent first
        self.link.mav.request_data_stream_send(self.link.target_system, 1, 0, 4, 1)

    def next(self, name: str) -> Any:
        """The next message of a name that comes from the autopilot itself."""
        message = self.link.recv_match(
            type=name, condition=f"{name}.get_srcComponent() == 1", blocking=True, timeout=WITHIN_S
        )
        if message is None:
            raise TimeoutError(f"the autopilot sends no {name}")
        return message

    def take_off(self) -> Any:
        """Have it climb, then loiter where it is; its position."""
        until_s = time.monotonic() + WITHIN_S
        while (place := self.next("GLOBAL_POSITION_INT")).relative_alt < HEIGHT_M * 1e3:
            if time.monotonic() > until_s:
                raise TimeoutError("the plane has not taken off")
            if self.next("HEARTBEAT").base_mode & mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED == 0:
                self.link.set_mode("TAKEOFF")
                self.link.arducopter_arm()
        self.link.set_mode("LOITER")
        return place


@dataclass
class Seen:
    """The flight as the ground station saw it after the orders: one entry for each position."""

    distance_m: list[float]
    height_m: list[float]
    off_yaw_deg: list[float]  # of the gimbal from the place, on the way to it


@contextmanager
def companion(url: str) -> Iterator[Pointing]:
    """Our end on board."""
    config = parse_config(f"[telemetry]\nurl = {json.dumps(url)}\n")
    pointing, stop = Pointing(config.telemetry.component), threading.Event()
    source = open_telemetry(config, SessionClock.start(), pointing=pointing)
    thread = threading.Thread(target=source.run, args=(lambda stamp_ns, event: None, stop))
    thread.start()
    try:
        yield pointing
    finally:
        stop.set()
        thread.join(ENDS_WITHIN_S)


def done(looks: LookThread, request: LookRequest) -> dict[str, Any]:
    """The answer to a request."""
    answers: list[bytes] = []
    looks.ask("benchmark", parameters_of(request), lambda payload, is_error: answers.append(payload))
    looks.work()
    content: dict[str, Any] = json.loads(answers[0])
    return content


def ordered(pointing: Pointing, place: Any) -> tuple[Offer, dict[str, Any], dict[str, Any]]:
    """Have it look at a place near the plane and circle about it: the circle's offer, and both acknowledgements."""
    lat_deg, lon_deg = place.lat / 1e7 + AWAY_DEG[0], place.lon / 1e7 + AWAY_DEG[1]
    made = replace(
        plain_set(), camera_lat_deg=lat_deg, camera_lon_deg=lon_deg, camera_height_m=place.alt / 1e3 - BELOW_M
    )
    packet = encode(made)
    feature_set = decode(packet)
    fix = Locator(feature_set).locate(PIXEL)
    assert isinstance(fix, Fix)
    limits = Look(max_radius_m=100.0, circle_radius_m=RADIUS_M)
    looks = LookThread(limits, lambda frame: (packet, 0.5), pointing)
    asked = AskLook(feature_set.session, feature_set.frame, *PIXEL, fix.lat_deg, fix.lon_deg, 10.0)
    look = Offer.of(done(looks, asked))
    looked = done(looks, ConfirmLook(look.ticket, 0.0))
    time.sleep(BETWEEN_S)
    offer = Offer.of(done(looks, AskCircle(look.ticket)))
    return offer, looked, done(looks, ConfirmLook(offer.ticket, 0.0))


def watched(ground: Ground, offer: Offer, seconds: float) -> Seen:
    """Look on for so long."""
    frame, seen = LocalFrame(offer.lat_deg, offer.lon_deg, offer.height_amsl_m), Seen([], [], [])
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s:
        m = ground.next("GLOBAL_POSITION_INT")
        east_m, north_m, _ = frame.to_enu(m.lat / 1e7, m.lon / 1e7, m.alt / 1e3)
        seen.distance_m.append(math.hypot(east_m, north_m))
        seen.height_m.append(m.alt / 1e3)
        gimbal = ground.link.messages.get("GIMBAL_DEVICE_ATTITUDE_STATUS")
        if gimbal is not None and seen.distance_m[-1] > 2.0 * RADIUS_M:
            w, x, y, z = gimbal.q
            yaw_deg = math.degrees(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
            wanted_deg = math.degrees(math.atan2(-east_m, -north_m)) - m.hdg / 100.0  # from the nose
            seen.off_yaw_deg.append(abs(within_180(yaw_deg - wanted_deg)))
    return seen


def report(offer: Offer, looked: dict[str, Any], circled: dict[str, Any], seen: Seen) -> bool:
    """Print what was measured; whether the goals are reached."""
    assert offer.circle is not None
    distance_m, height_m = np.array(seen.distance_m), np.array(seen.height_m)
    on_it = np.arange(len(distance_m)) >= max(int(np.argmax(distance_m < SETTLED * RADIUS_M)), len(distance_m) // 2)
    radius_m = float(np.median(distance_m[on_it]))
    off_m = float(np.abs(height_m - offer.circle.height_amsl_m)[on_it].max())
    yaw_deg = float(np.median(seen.off_yaw_deg)) if seen.off_yaw_deg else math.nan
    reached = (
        looked.get("result") == circled.get("result") == "accepted",
        abs(radius_m / RADIUS_M - 1.0) <= RADIUS_GOAL and bool(np.ptp(distance_m[on_it]) < 0.2 * RADIUS_M),
        off_m <= HEIGHT_GOAL_M,
        yaw_deg <= YAW_GOAL_DEG,
    )
    answers = ", ".join(str(content.get("result", content)) for content in (looked, circled))
    spread = f"{distance_m[on_it].min():.0f} to {distance_m[on_it].max():.0f} m"
    rows = [
        ("look, circle", answers, verdict(reached[0])),
        (f"radius, {RADIUS_M:.0f} m asked", f"{radius_m:.0f} m ({spread})", verdict(reached[1])),
        ("height off what was confirmed", f"{off_m:.1f} m", verdict(reached[2])),
        ("gimbal's yaw off the place, on the way", f"{yaw_deg:.1f} deg (median)", verdict(reached[3])),
    ]
    print(table(("what", "measured", "goal"), rows))
    return all(reached)


def main() -> int:
    """0 if the goals are reached or there is no autopilot, 1 if not."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=90.0)
    wanted = with_simulator(parser, "ADDRESS", "the ground station's port, as mavutil's")
    if wanted is None:
        return 0
    with autopilot(wanted.autopilot), companion(wanted.onboard) as pointing:
        ground = Ground(wanted.ground)
        offer, looked, circled = ordered(pointing, ground.take_off())
        seen = watched(ground, offer, wanted.seconds)
    return 0 if report(offer, looked, circled, seen) else 1


if __name__ == "__main__":
    raise SystemExit(main())
