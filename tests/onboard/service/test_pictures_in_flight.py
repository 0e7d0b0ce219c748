"""A flight in the daemon whose keyframes cross a loopback link: each frame's picture is that frame's picture."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.topics import ANY_VEHICLE, PICTURE
from ground.client import SetCache
from ground.link_pictures import PictureCache
from onboard.commands.run import open_parts
from onboard.config.schema import Config, PictureConfig
from onboard.events.session_clock import SessionClock
from onboard.events.sink import Sink
from onboard.events.types import Frame
from onboard.link.picture_sender import PictureSender
from onboard.link.publisher import Publisher, Rate
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.onboard.service.air import STRAIGHT, PlayedSource, Work, take_off
from tests.waiting import eventually


class Passed:
    """Hands on to a sink that outlives the flight, which may be over before its thread has had a turn."""

    def __init__(self, sink: Sink) -> None:
        self.event, self.feature_set = sink.event, sink.feature_set

    def __enter__(self) -> Passed:
        return self

    def __exit__(self, *_: object) -> None:
        return None


@pytest.mark.parametrize("is_on", [False, True])
def test_the_daemon_sends_pictures_if_configured_and_warns_where_there_is_no_room(
    tmp_path: Path, is_on: bool, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "camera.json").write_text(plain_set().camera.to_json())
    config = Config.model_validate(
        {
            "camera": {"file": str(tmp_path / "camera.json")},
            "telemetry": {"url": free_endpoint().replace("tcp/", "udpin:")},
            "link": {"listen": (free_endpoint(),)},
            "service": {"state_dir": str(tmp_path)},
            **({"picture": {"enabled": True}} if is_on else {}),
        }
    )
    parts = open_parts(config, open_camera=lambda *_: PlayedSource(SessionClock.start(), [], Work()))
    with parts.resources:
        assert sum(isinstance(sink, PictureSender) for sink in parts.sinks) == is_on
        assert ("link.max_bit_rate = 32000 leaves" in caplog.text) == is_on
        assert ("pictures" in [thread.name for thread in parts.threads]) == is_on


def test_the_ground_gets_the_right_image_for_the_frame(tmp_path: Path) -> None:
    endpoint, pictures = free_endpoint(), PictureCache()
    section = PictureConfig(enabled=True, max_px=240, rate_hz=5.0)
    vehicle = "uav"
    with (
        Publisher(vehicle, [endpoint], rate=Rate(1e6)) as link,
        PictureSender(section, link) as sender,
        SetCache(endpoint, subscriptions={PICTURE.key(ANY_VEHICLE): pictures.take}) as cache,
    ):
        assert eventually(link.picture_room)  # until the ground is there

        def sinks() -> Sequence[Sink]:
            return [Passed(sender), Passed(link)]

        air = take_off(tmp_path, spec=dataclasses.replace(STRAIGHT, seconds=5.0), sinks=sinks)
        assert air.code == 0
        assert eventually(lambda: pictures.received)
        images = {e.index: e.image for e in air.received.events if isinstance(e, Frame)}
        (session,) = {s.session for _, s in air.received.sets}
        by_frame = {s.frame: s for _, s in air.received.sets}
        frames = pictures.frames(vehicle, session)
        assert frames and pictures.dropped.unreadable == 0
        for frame in frames:
            picture = pictures.picture(vehicle, session, frame)
            its_set = by_frame[frame]
            assert its_set.is_keyframe and picture.capture_unix_ns == its_set.capture_unix_ns
            got = cv2.imdecode(np.frombuffer(picture.content, np.uint8), cv2.IMREAD_GRAYSCALE)
            errors = {}
            for number, image in images.items():
                assert image is not None
                small = cv2.resize(image, got.shape[::-1], interpolation=cv2.INTER_AREA)
                errors[number] = float(np.mean((got.astype(float) - small) ** 2))
            assert min(errors, key=errors.__getitem__) == frame
        assert cache.vehicles == [vehicle]
