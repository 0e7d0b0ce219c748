"""A flight in the daemon while things are followed: asked for over the link, reported on it, and the sets are sent."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import pytest

from contract.feature_set import FeatureSet
from contract.topics import TRACKS
from contract.track import StartTrack, TrackReport, TrackState
from ground.track_link import TrackLink
from onboard.commands.run import open_parts
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.sink import Sink
from onboard.link.publisher import Publisher, Rate
from onboard.service.session import Session
from onboard.service.track_thread import TrackThread
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.onboard.service.air import STRAIGHT, PlayedSource, Work, take_off
from tests.onboard.service.test_pictures_in_flight import Passed
from tests.set_sink import SetSink
from tests.waiting import eventually

CLICKED = 10


@pytest.mark.parametrize("is_on", [False, True])
def test_the_daemon_follows_unless_configured_not_to(tmp_path: Path, is_on: bool) -> None:
    (tmp_path / "camera.json").write_text(plain_set().camera.to_json())
    endpoint = free_endpoint()
    config = Config.model_validate(
        {
            "camera": {"file": str(tmp_path / "camera.json")},
            "telemetry": {"url": free_endpoint().replace("tcp/", "udpin:")},
            "link": {"listen": (endpoint,)},
            "service": {"state_dir": str(tmp_path)},
            "tracks": {"enabled": is_on},
        }
    )
    parts = open_parts(config, open_camera=lambda *_: PlayedSource(SessionClock.start(), [], Work()))
    with parts.resources:
        assert ("tracks" in [thread.name for thread in parts.threads]) == is_on
        assert any(isinstance(sink, TrackThread) for sink in parts.sinks) == is_on
        publisher = next(sink for sink in parts.sinks if isinstance(sink, Publisher))
        assert (b"disabled" in publisher.follow("")[0]) == (not is_on)
        assert Session(config, parts).report().status.follows == is_on  # so that the page offers it only where it is


class Asking(SetSink):
    """A sink that clicks in the middle of one picture, after its set has been handed over."""

    def __init__(self, tracks: TrackThread) -> None:
        self._tracks, self.answer = tracks, b""

    def feature_set(self, output: FeatureSet) -> None:
        if output.frame > CLICKED and not self.answer:
            assert eventually(lambda: CLICKED in self._tracks._frames)
            self.answer, is_error = self._tracks.answer(f"u=150;v=110;frame={CLICKED}")
            assert not is_error, self.answer


def test_a_spot_of_ground_is_followed_through_a_flight_at_rest(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    received: list[TrackReport] = []
    with (
        Publisher("uav", [endpoint], rate=Rate(1e6)) as link,
        TrackThread(Config(), [lambda _, payload: link.report(TRACKS, payload)]) as tracks,
        TrackLink(endpoint, "uav") as ground,
    ):
        link.follow = tracks.answer
        asking = Asking(tracks)

        def sinks() -> Sequence[Sink]:
            return [Passed(link), Passed(tracks), asking]

        air = take_off(tmp_path, spec=dataclasses.replace(STRAIGHT, seconds=5.0), sinks=sinks)
        assert air.code == 0 and air.received is not None and asking.answer == b'{"track":1,"frame":10}'

        def is_told() -> bool:
            while (report := ground.next(0.05)) is not None:
                received.append(report)
            return bool(received) and received[-1].frame > CLICKED + 5

        assert eventually(is_told)
        assert ground.ask(StartTrack(150.0, 110.0, CLICKED)).get("track") == 1 or received[-1].state is TrackState.LOST
    last = received[-1]
    assert last.number == 1
    assert not any(report.course.is_moving for report in received if report.course is not None)
    by_frame = {s.frame: s for _, s in air.received.sets}
    assert last.session == by_frame[CLICKED].session
    assert abs(last.place.lat_deg - by_frame[CLICKED].camera_lat_deg) < 0.005
