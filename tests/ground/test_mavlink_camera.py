"""A camera component on a laptop: sets that come over zenoh answer a standard's client, the aircraft follows."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import pytest

from contract.answer import Ellipse, Place
from contract.feature_set import Status
from contract.topics import TRACKS
from contract.track import Course, TrackReport, TrackState, Unseen
from contract.wire.track_code import encode_track
from ground.mavlink_camera import CLOCK_SIGMA_S, CameraOptions, GroundCamera
from ground.mavlink_endpoint import MavlinkEndpoint
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.ports import free_endpoint, free_udp_port
from tests.onboard.telemetry.standard_client import StandardClient, standard
from tests.onboard.tracks.flat_world import CAMERA, PLACE, Thing, World, at
from tests.waiting import eventually

pytestmark = pytest.mark.wall_clock(waits=True)
SPEED_M_S, DELAY_S, SIGMA_S = 8.0, 0.5, 0.2
CAR = Thing(at(16.0, 6.0))
WORLD = World((CAR,), camera=lambda t: (SPEED_M_S * t, 0.0))


class Aircraft:
    """Publishes ten sets a second of a flight that began with it, and follows whatever it is asked to."""

    def __init__(self) -> None:
        self.endpoint, self.began_s, self.asked = free_endpoint(), time.time(), list[str]()
        self.publisher = Publisher("uav-1", [self.endpoint], rate=Rate(1e7, 1.0, 30.0))
        self.publisher.follow = self._follow
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._fly)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(5.0)
        self.publisher.close()

    def _follow(self, parameters: str) -> tuple[bytes, bool]:
        self.asked.append(parameters)
        return (b'{"track":7}', False) if "u=" in parameters else (b'{"tracks":[]}', False)

    def _fly(self) -> None:
        number = 0
        while not self._stop.wait(max(self.began_s + number / 10.0 - time.time(), 0.0)):
            stamp_ns = round((self.began_s + number / 10.0) * 1e9)
            found = replace(WORLD.its_set(number), capture_unix_ns=stamp_ns, session=int(self.began_s))
            self.publisher.publish(found)
            if any("u=" in asked for asked in self.asked) and number % 5 == 0:
                place = Place(PLACE.lat_deg, PLACE.lon_deg, 100.0, 110.0, Ellipse(2.0, 1.0, 0.0), 1.0)
                self.publisher.report(TRACKS, encode_track(TrackReport(
                    7, TrackState.FOLLOWED, Unseen.NONE, int(self.began_s), number, stamp_ns, 79.5, 59.5, 8.0,
                    Status.OK, place, Course(3.0, 0.2, 90.0, 4.0),
                )))  # fmt: skip
            number += 1


@pytest.fixture
def aircraft() -> Iterator[Aircraft]:
    made = Aircraft()
    yield made
    made.close()


def test_a_click_at_a_laptop_is_answered_from_the_sets_of_its_link_and_followed_on_board(aircraft: Aircraft) -> None:
    port, stop = free_udp_port(), threading.Event()
    options = CameraOptions(delay_s=DELAY_S, sigma_delay_s=SIGMA_S)
    camera = GroundCamera(MavlinkEndpoint.parse(f"udpin:127.0.0.1:{port}"), aircraft.endpoint, "uav-1", options=options)

    def serve() -> None:
        while not stop.is_set():
            camera.look()

    client, thread = StandardClient(port), threading.Thread(target=serve)
    with camera:
        thread.start()
        try:
            client.wait("HEARTBEAT")
            assert "answers for 'uav-1'" in camera.state
            assert eventually(lambda: time.time() - aircraft.began_s > 2.0)
            shown_s = time.time() - aircraft.began_s - DELAY_S
            u, v = WORLD.pixel(CAR, 0) - [SPEED_M_S * shown_s / 0.2, 0.0]
            share = float((u + 0.5) / CAMERA.width_px), float((v + 0.5) / CAMERA.height_px)
            answer, since = client.command(standard.MAV_CMD_CAMERA_TRACK_POINT, *share, 0.02)
            geo = client.wait("CAMERA_TRACKING_GEO_STATUS", since)
            image_id = standard.MAVLINK_MSG_ID_CAMERA_TRACKING_IMAGE_STATUS
            _, since = client.command(standard.MAV_CMD_SET_MESSAGE_INTERVAL, image_id, 2e5)
            image = client.wait("CAMERA_TRACKING_IMAGE_STATUS", since)
            assert client.command(standard.MAV_CMD_CAMERA_STOP_TRACKING)[0].result == 0
            assert eventually(lambda: aircraft.asked[-1] == "stop=7")
        finally:
            stop.set()
            thread.join(5.0)
            client.close()
    assert answer.result == 0 and geo.tracking_status == 1
    east_m, north_m, _ = PLACE.to_enu(geo.lat * 1e-7, geo.lon * 1e-7, geo.alt)
    assert abs(east_m - 16.0 - 0.8) < 2.0 and abs(north_m - 6.0 + 0.5) < 0.2
    spread_m = 2.146 * SPEED_M_S * (SIGMA_S**2 + CLOCK_SIGMA_S**2) ** 0.5
    assert spread_m < geo.h_acc < 1.3 * spread_m
    assert (image.tracking_status, round(image.point_x, 3), round(image.point_y, 3)) == (1, 0.25, 0.25)
    assert aircraft.asked[0].startswith("u=")


def test_another_aircraft_s_autopilot_gets_no_camera_and_is_named(aircraft: Aircraft) -> None:
    """Clicks in its video were answered by the sets of the one that was named, wherever that flew."""
    port = free_udp_port()
    client = StandardClient(port)
    with GroundCamera(MavlinkEndpoint.parse(f"udpin:127.0.0.1:{port}"), aircraft.endpoint, "uav-1") as camera:

        def answers_at(east_m: float) -> bool:
            travelled_m = SPEED_M_S * (time.time() - aircraft.began_s)
            lat, lon, _ = PLACE.to_geodetic([travelled_m + east_m, 0.0, 60.0])
            client.send_position(float(lat), float(lon), SPEED_M_S)
            camera.look()
            return "answers for 'uav-1'" in camera.state

        assert eventually(lambda: answers_at(0.0))
        assert eventually(lambda: not answers_at(700.0))
        assert "m from where 'uav-1' is: it is another aircraft's" in camera.state
        assert eventually(lambda: answers_at(0.0))
    client.close()


def test_without_an_autopilot_or_sets_it_states_what_is_missing() -> None:
    wire = MavlinkEndpoint.parse(f"udpout:127.0.0.1:{free_udp_port()}")
    with GroundCamera(wire, free_endpoint(), "uav-1") as camera:
        camera.look()
        assert camera.state == "no autopilot yet"
    with GroundCamera(wire, free_endpoint(), "uav-1", options=CameraOptions(system=3)) as camera:
        camera.look()
        assert camera.state.startswith("system 3: no set of 'uav-1' yet")
