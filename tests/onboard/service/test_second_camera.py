"""A thermal camera next to the first one in the daemon: its own thread and stamps; when it fails, nothing else does."""

import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from contract.camera import Camera
from contract.errors import InputError
from contract.wire.spot_code import decode_spots
from onboard.commands.run import open_parts
from onboard.config.schema import Config, parse_config
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, SourceStatus, State, Stop
from onboard.events.types import Attitude, Frame
from onboard.service.second_camera import SecondCameraThread
from onboard.service.spot_thread import SpotThread
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.onboard.service.air import PlayedSource, Work
from tests.onboard.spots.scenes import BOSON
from tests.onboard.spots.two_cameras import Turn, thermal_frame
from tests.waiting import eventually

TURN = Turn()


class Scripted:
    def __init__(self, frames: list[Frame], fails: int = 0) -> None:
        self._frames, self._fails = frames, fails

    def run(self, emit: Emit, stop: Stop) -> None:
        if self._fails:
            self._fails -= 1
            raise InputError("no such camera")
        emit(0, Attitude(0, (1.0, 0.0, 0.0, 0.0)))
        for frame in self._frames:
            emit(0, frame)
        stop.wait()

    def health(self) -> SourceStatus:
        return SourceStatus(State.OK)


def test_its_pictures_and_nothing_else_are_handed_on_and_it_is_begun_again_after_a_failure() -> None:
    frames, taken = [thermal_frame(0.1 * k, k) for k in range(3)], []
    with SecondCameraThread(Scripted(frames, fails=1), taken.append) as second:
        assert eventually(lambda: taken == frames)
        assert "no such camera" in second.thread.report().last_error
    assert not second.thread.is_alive()


def test_pictures_of_one_thread_and_sets_of_another_meet_and_those_that_were_looked_at_are_kept() -> None:
    config = parse_config('[vehicle]\nid = "uav-1"\n[camera.thermal]\nfile = "thermal.json"\nscale = 0.01\n')
    sent: list[bytes] = []
    counts = np.full(BOSON.size_px[::-1], 29000, np.uint16)
    frames = [replace(thermal_frame(0.25 + 0.6 * k, k), counts=counts) for k in range(5)]
    kept: list[Frame] = []
    with SpotThread(config, [lambda _, payload: sent.append(payload)], BOSON) as spots:
        spots.keepers.append(kept.append)
        other = threading.Thread(target=lambda: [spots.second_picture(frame) for frame in frames])
        other.start()
        for k in range(16):
            spots.feature_set(TURN.first_set(k))
        other.join()
        spots.feature_set(TURN.first_set(16))
        assert eventually(lambda: sent)
    assert all(not decode_spots(payload).spots for payload in sent)
    assert {decode_spots(payload).frame for payload in sent} <= {1, 4, 7, 10, 13}
    stamps_ns = [decode_spots(payload).capture_unix_ns for payload in sent]
    assert [frame.stamp_ns for frame in kept] == pytest.approx(stamps_ns, abs=100_000)  # as packets have it


def configured(tmp_path: Path, **thermal: object) -> Config:
    (tmp_path / "camera.json").write_text(plain_set().camera.to_json())
    (tmp_path / "thermal.json").write_text(Camera.from_field_of_view(160, 120, 57.0).to_json())
    return Config.model_validate(
        {
            "camera": {"file": str(tmp_path / "camera.json"), "thermal": thermal},
            "telemetry": {"url": free_endpoint().replace("tcp/", "udpin:")},
            "link": {"listen": (free_endpoint(),)},
            "service": {"state_dir": str(tmp_path)},
        }
    )


@pytest.mark.parametrize("is_there", [False, True])
def test_the_daemon_opens_a_second_camera_where_one_is_named_and_records_what_is_looked_at(
    tmp_path: Path, is_there: bool
) -> None:
    (tmp_path / "heat").mkdir()
    Image.fromarray(np.full((120, 160), 29000, np.uint16)).save(tmp_path / "heat" / "20260612T101523.25Z.png")
    named = {"device": f"replay:{tmp_path / 'heat'}", "file": str(tmp_path / "thermal.json"), "scale": 0.01}
    config = configured(tmp_path, **(named if is_there else {}))
    parts = open_parts(config, open_camera=lambda *_: PlayedSource(SessionClock.start(), [], Work()))
    with parts.resources:
        assert [name for name in ("spots", "thermal camera") if name in [t.name for t in parts.threads]] == (
            ["spots", "thermal camera"] if is_there else []
        )
        assert (parts.thermal_camera is not None) == is_there
        spots = [sink for sink in parts.sinks if isinstance(sink, SpotThread)]
        assert parts.recording is not None
        assert [one.keepers for one in spots] == ([[parts.recording.second_picture]] if is_there else [])
