"""The whole way of "look there": a certificate's holder asks over the link, an aircraft answers, an autopilot looks."""

import dataclasses
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.answer import Fix
from contract.errors import LinkError
from contract.feature_set import FeatureSet
from contract.link_config import Tls
from contract.locate import Locator
from contract.look import AskCircle, AskLook, Offer
from contract.vehicle_status import VehicleStatus
from contract.wire.codec import decode
from ground.look_link import LookLink
from ground.put_request import RequestRefused
from onboard.commands.run import open_parts
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import State
from onboard.link.certificates import make_credentials
from onboard.link.publisher import Publisher
from onboard.service.session import Parts, Session
from simulation.autopilot.fake import FakeAutopilot
from tests.contract.sets import plain_set
from tests.onboard.link.asking import answered
from tests.onboard.link.ports import free_endpoint, free_udp_port
from tests.onboard.service.air import PlayedSource, Work
from tests.onboard.telemetry.listening import FLIGHT
from tests.waiting import PATIENCE_S, eventually

PIXEL = (320.0, 240.0)
CAMERA_M = 50.0  # of the published set, above mean sea level: its ground is below the autopilot's 350 m


def configuration(folder: Path, **sections: dict[str, object]) -> Config:
    """An aircraft with certificates, whose link anna and ben may use."""
    (folder / "camera.json").write_text(plain_set().camera.to_json())
    keys = folder / "keys"
    if not keys.exists():
        make_credentials(keys, ["uav-1"], ["anna", "ben"], [], 30.0)
    link = {
        "listen": (free_endpoint().replace("tcp/", "tls/"),), "max_bit_rate": 1e6,
        "ca": str(keys / "uav-1" / "ca.pem"), "certificate": str(keys / "uav-1" / "certificate.pem"),
        "key": str(keys / "uav-1" / "key.pem"),
    }  # fmt: skip
    given: dict[str, dict[str, object]] = {
        "vehicle": {"id": "uav-1"}, "camera": {"file": str(folder / "camera.json")},
        "telemetry": {"url": f"udpin:127.0.0.1:{free_udp_port()}", "system": FLIGHT.system},
        "service": {"state_dir": str(folder)}, "recording": {"enabled": False}, "tracks": {"enabled": False},
    }  # fmt: skip
    return Config.model_validate(
        given | {"link": link | sections.pop("link", {})} | {k: given.get(k, {}) | v for k, v in sections.items()}
    )


def opened(config: Config) -> Parts:
    return open_parts(config, open_camera=lambda *_: PlayedSource(SessionClock.start(), [], Work()))


@pytest.mark.parametrize("pointers", [(), ("anna",)])
def test_the_daemon_lets_no_one_point_its_camera_unless_configured(tmp_path: Path, pointers: tuple[str, ...]) -> None:
    config = configuration(tmp_path, link={"pointers": pointers})
    parts = opened(config)
    with parts.resources:
        assert ("looks" in [thread.name for thread in parts.threads]) == bool(pointers)
        status = Session(config, parts).report().status
        assert status.looks == bool(pointers) and status.look == ""


@dataclass
class Flying:
    config: Config
    parts: Parts
    autopilot: FakeAutopilot
    publisher: Publisher
    published: FeatureSet

    @property
    def status(self) -> VehicleStatus:
        return Session(self.config, self.parts).report().status

    def link(self, name: str) -> LookLink:
        tls = Tls.in_folder(Path(str(self.config.link.ca)).parents[1] / name)
        return answered(lambda: LookLink(self.config.link.listen[0], None, tls))

    def click(self, **change: float) -> AskLook:
        s, fix = self.published, Locator(self.published).locate(PIXEL)
        assert isinstance(fix, Fix)
        asked = AskLook(s.session, s.frame, *PIXEL, fix.lat_deg, fix.lon_deg, fix.ellipse.semi_major_m)
        return dataclasses.replace(asked, **change)  # type: ignore[arg-type]


def confirmed(link: LookLink, asked: AskLook | AskCircle) -> tuple[Offer, dict[str, Any]]:
    """An offer that was confirmed, and the answer. What a busy machine delays too long is asked for again."""
    while True:
        offer = answered(lambda: link.ask(asked))
        came_s = time.monotonic()
        try:
            return offer, link.confirm(offer, time.monotonic() - came_s)
        except RequestRefused as error:
            if error.word not in ("late", "busy", "not_acknowledged"):
                raise


def refusal(link: LookLink, click: AskLook) -> str:
    with pytest.raises(LinkError) as refused:
        link.ask(click)
    return refused.value.word if isinstance(refused.value, RequestRefused) else "no answer"


@pytest.fixture(params=["pymavlink", "mavsdk"])
def flying(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Flying]:
    with FakeAutopilot(FLIGHT, f"udpout:127.0.0.1:{free_udp_port()}", loop=True) as autopilot:
        config = configuration(
            tmp_path,
            link={"pointers": ("anna", "ben")},
            look={"max_radius_m": 40.0, "circle_radius_m": 120.0},
            telemetry={"url": autopilot.url, "backend": request.param},
        )
        parts, stop = opened(config), threading.Event()
        with parts.resources:
            publisher = next(sink for sink in parts.sinks if isinstance(sink, Publisher))
            listening = threading.Thread(target=parts.telemetry.run, args=(lambda *_: None, stop), daemon=True)
            listening.start()
            try:
                assert eventually(lambda: parts.telemetry.health().state is State.OK)
                made = dataclasses.replace(plain_set(), capture_unix_ns=time.time_ns(), camera_height_m=CAMERA_M)
                published = decode(publisher.publish(made))
                yield Flying(config, parts, autopilot, publisher, published)
            finally:
                stop.set()
                listening.join(PATIENCE_S)


def test_the_camera_looks_where_it_was_clicked_and_everybody_sees_who_had_it_look(flying: Flying) -> None:
    autopilot = flying.autopilot
    with flying.link("anna") as anna:
        answered(lambda: anna.ask(flying.click()))
        assert autopilot.received_of("COMMAND_INT") == [] and flying.status.look == ""
        _, done = confirmed(anna, flying.click())
    assert done["result"] == "accepted"
    fix = Locator(flying.published).locate(PIXEL)
    assert isinstance(fix, Fix) and autopilot.roi is not None
    assert autopilot.roi[:2] == pytest.approx((fix.lat_deg, fix.lon_deg), abs=1e-6)
    assert autopilot.roi[2] == pytest.approx(fix.height_amsl_m, abs=0.1)  # above the sea, not the ellipsoid
    words = f"at {fix.lat_deg:.5f} {fix.lon_deg:.5f}, {fix.height_amsl_m:.0f} m"
    assert flying.status.look == f"anna: {words}: accepted"
    pilot = f"pointclick: anna has the camera look {words}"
    assert eventually(lambda: pilot in "".join(text.text for text in autopilot.received_of("STATUSTEXT")))
    with flying.link("ben") as ben:

        def ends() -> bool:
            try:
                return bool(ben.end()["result"] == "accepted")
            except RequestRefused as error:
                assert error.word == "busy"  # anna's command was less than two seconds ago
                return False

        assert eventually(ends)
    assert autopilot.roi is None and flying.status.look == "ben: ahead: accepted"


def test_the_aircraft_circles_about_what_its_camera_looks_at_as_high_as_its_autopilot_flies(flying: Flying) -> None:
    autopilot = flying.autopilot
    with flying.link("anna") as anna:
        look, done = confirmed(anna, flying.click())
        assert done["may_circle"] is True and autopilot.circle is None
        offer, done = confirmed(anna, AskCircle(look.ticket))
    assert done["result"] == "accepted" and offer.circle is not None and autopilot.circle is not None
    lat, lon, height_m, radius_m = autopilot.circle
    assert (lat, lon) == pytest.approx((look.lat_deg, look.lon_deg), abs=1e-6) and radius_m == 120.0
    heights_m = [m.alt / 1000.0 for m in FLIGHT.messages if m.get_type() == "GLOBAL_POSITION_INT"]
    assert min(heights_m) - 0.1 <= height_m <= max(heights_m) + 0.1
    assert offer.circle.above_place_m == pytest.approx(height_m - look.height_amsl_m, abs=0.2)
    assert flying.status.look.startswith("anna: circling ") and flying.status.look.endswith(": accepted")


def test_what_the_autopilot_refuses_is_stated_and_nothing_that_does_not_hold_gets_to_it(flying: Flying) -> None:
    autopilot = flying.autopilot
    autopilot.roi_results.extend([int(mavlink.MAV_RESULT_DENIED)] * 20)
    with flying.link("anna") as anna:
        for change, word in (({"lat_deg": 0.0}, "contradiction"), ({"frame": 5}, "unknown_frame")):
            assert eventually(lambda change=change, word=word: refusal(anna, flying.click(**change)) == word)
        assert autopilot.received_of("COMMAND_INT") == []
        with pytest.raises(RequestRefused, match="denied: the autopilot refuses"):
            confirmed(anna, flying.click())
    assert autopilot.roi is None and flying.status.look.endswith(": denied")
