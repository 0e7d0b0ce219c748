"""Faults in flight: seen within two seconds, recovered from alone, and no answer off the truth. docs/faults.md."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.errors import InputError
from contract.feature_set import Status
from ground.recording import Recording
from onboard.events.types import Event, Frame, GpsQuality, PositionFix
from onboard.storage.mcap_writer import SessionRecorder
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.onboard.service.air import Air, Spoil, take_off
from tests.scenarios.flights import CAMERA

BEGIN_S, END_S = 9.0, 14.0  # of most faults
SECONDS = 21.5  # of their flights: what is back six seconds after the end is in the air for some more
SEEN_S = 2.0 + 1.0 + 0.5  # two seconds, until the next status is due, and the daemon's ticks
LONG = SessionSpec(DescribedSpec(PathSpec("straight")), seconds=84.0, rate_hz=2.0, camera=CAMERA)


def is_on(t_s: float) -> bool:
    return BEGIN_S <= t_s < END_S


def on_pictures(change: object) -> Spoil:
    def spoil(event: Event, t_s: float) -> Event | None:
        if isinstance(event, Frame) and is_on(t_s):
            assert event.image is not None
            return replace(event, image=change(event.image))
        return event

    return spoil


def never(event: Event, t_s: float) -> Event | None:
    return None if is_on(t_s) else event


def holds(air: Air, *words: str, begin_s: float = BEGIN_S, end_s: float = END_S, back_s: float = 6.0) -> None:
    """One of the words within the time allowed, answers again after the end, the truth inside, nothing lost."""
    assert air.code == 0
    seen_s = min(air.first(word, begin_s) for word in words)
    assert seen_s - begin_s < SEEN_S, (seen_s, air.states(begin_s - 1.0, end_s + 8.0))
    assert "ok" in air.states(begin_s - 3.0, begin_s)
    again_s = air.first("ok", max(end_s, seen_s))
    assert again_s - end_s < back_s, (again_s, air.states(begin_s - 1.0, end_s + 8.0))
    for stretch in ((-1e9, begin_s), (begin_s, end_s + back_s), (end_s, 1e9)):
        outcome = air.clicked(*stretch)
        # Of a flight's clicks most share one error: a stretch is all inside or is not.
        assert outcome.inside_99 > 0.97, outcome.reported
    (recording,) = air.recordings
    kept = Recording(recording)
    assert kept.frames("uav") == [e.index for e in air.received.events if isinstance(e, Frame)]


def test_a_camera_that_goes_and_comes_back(tmp_path: Path) -> None:
    air = take_off(tmp_path, seconds=SECONDS, camera=never)
    holds(air, "camera lost")
    assert "camera lost" in [air.state(t) for t in np.arange(BEGIN_S + 3.0, END_S)]
    assert any(text.startswith("pointclick: camera lost: ") for _, text in air.telemetry.reported)


@pytest.mark.long  # short, without a daemon: a picture repeated of tests/scenarios/test_degraded_pictures.py
def test_a_frozen_camera_that_no_one_calls_frozen(tmp_path: Path) -> None:
    """The driver goes on giving the last picture as new: the estimator must not believe it."""
    held: list[Frame] = []

    def frozen(event: Event, t_s: float) -> Event:
        if not isinstance(event, Frame):
            return event
        if not is_on(t_s):
            held[:] = [event]
            return event
        return replace(event, image=held[0].image)

    air = take_off(tmp_path, seconds=SECONDS, camera=frozen)
    assert air.code == 0
    during = air.clicked(BEGIN_S + 0.3, END_S)
    assert not len(during.errors_m), during.reported
    assert air.first("bad picture", BEGIN_S) - BEGIN_S < SEEN_S, air.states(BEGIN_S, END_S)
    assert air.first("ok", END_S) < END_S + 6.0, air.states(BEGIN_S, 26.0)
    after = air.clicked(END_S, 1e9)
    assert after.inside_99 > 0.97, after.reported


@pytest.mark.long  # short, without a daemon: "black pictures" of tests/scenarios/test_scenarios.py
@pytest.mark.parametrize("level", [0, 255])
def test_black_and_white_pictures(tmp_path: Path, level: int) -> None:
    air = take_off(tmp_path, seconds=SECONDS, camera=on_pictures(lambda image: np.full_like(image, level)))
    holds(air, "featureless", "bad picture")  # the latter where even the noise is gone
    assert not len(air.clicked(BEGIN_S, END_S).errors_m)


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_defocused_pictures_are_refused_or_held(tmp_path: Path, noise: float) -> None:
    """Optics blur the ground and not the sensor's noise, but an image processor may smooth that too.

    Short, without a daemon: "out of focus" of tests/scenarios/test_scenarios.py.
    """
    rng = np.random.default_rng(6)

    def defocused(image: np.ndarray) -> np.ndarray:
        blurred = cv2.GaussianBlur(image, (0, 0), 12.0)
        return np.clip(blurred + noise * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)

    air = take_off(tmp_path, seconds=SECONDS, camera=on_pictures(defocused))
    assert air.code == 0
    outcome = air.clicked()
    assert outcome.inside_99 > 0.97, outcome.reported
    assert air.first("ok", END_S) < END_S + 6.0
    refused = {s.status for s in air.sets(BEGIN_S, END_S).values()}
    assert refused <= {Status.OK, Status.FEATURELESS, Status.POOR_FIT, Status.STARTING, Status.UNCERTAIN}


@pytest.mark.long  # short: three seconds without a fix, a scenario
def test_telemetry_gone_for_a_second_costs_nothing_but_that_second(tmp_path: Path) -> None:
    def cut(event: Event, t_s: float) -> Event | None:
        return None if 9.0 <= t_s < 10.0 else event

    air = take_off(tmp_path, seconds=15.0, telemetry=cut)
    assert air.code == 0
    assert "telemetry lost" not in air.states(4.0, 15.0)
    outcome = air.clicked()
    assert outcome.inside_99 > 0.97, outcome.reported
    assert {s.status for s in air.sets(11.0, 15.0).values()} == {Status.OK}


@pytest.mark.long  # the short one is of a second
@pytest.mark.parametrize(("begin_s", "end_s", "more"), [(7.0, 17.0, {}), (10.0, 70.0, {"back_s": 9.0})])
def test_telemetry_gone_for_ten_seconds_and_for_a_minute(
    tmp_path: Path, begin_s: float, end_s: float, more: dict[str, float]
) -> None:
    def cut(event: Event, t_s: float) -> Event | None:
        return None if begin_s <= t_s < end_s else event

    air = take_off(tmp_path, telemetry=cut, **({"spec": LONG} if more else {}))
    holds(air, "telemetry lost", begin_s=begin_s, end_s=end_s, **more)
    assert Status.OK not in {s.status for s in air.sets(begin_s + 1.0, end_s - 0.5).values()}


@pytest.mark.long  # short, without a daemon: "without a fix" of tests/scenarios/test_scenarios.py
def test_gps_off(tmp_path: Path) -> None:
    """As ArduPilot tells of it: only fix type and satellites change, the filter goes on."""

    def off(event: Event, t_s: float) -> Event:
        return replace(event, fix_type=1, satellites=0) if isinstance(event, GpsQuality) and is_on(t_s) else event

    air = take_off(tmp_path, seconds=SECONDS, telemetry=off)
    holds(air, "no gps")
    assert not len(air.clicked(BEGIN_S + 0.5, END_S).errors_m)


@pytest.mark.long  # short, without a daemon: tests/onboard/navigation, tests/scenarios/test_degraded_sensors.py
def test_gps_glitch(tmp_path: Path) -> None:
    """Forty metres aside at once, for a second, and back."""

    def jump(event: Event, t_s: float) -> Event:
        aside = 10.0 <= t_s < 11.0
        return (
            replace(event, lat_deg=event.lat_deg + 40.0 / 111_000.0)
            if isinstance(event, PositionFix) and aside
            else event
        )

    air = take_off(tmp_path, telemetry=jump)
    holds(air, "no gps", begin_s=10.0, end_s=11.0 + 5.0)  # gps.settle_s
    assert not len(air.clicked(10.0, 15.0).errors_m)


@pytest.mark.long  # short, without a daemon: tests/onboard/navigation/test_navigator.py
def test_a_jammed_gps_that_drifts_against_its_velocity(tmp_path: Path) -> None:
    """The position runs away at 4 m/s while velocity says otherwise; then it is back at once."""

    def drift(event: Event, t_s: float) -> Event:
        if not isinstance(event, PositionFix) or not is_on(t_s):
            return event
        return replace(event, lat_deg=event.lat_deg + 4.0 * (t_s - BEGIN_S) / 111_000.0)

    air = take_off(tmp_path, telemetry=drift)
    holds(air, "no gps", back_s=9.0)


@pytest.mark.long
def test_featureless_ground_is_called_that(tmp_path: Path) -> None:
    """Water: nothing but the sensor's noise. Short: black pictures, above."""
    rng = np.random.default_rng(5)

    def water(image: np.ndarray) -> np.ndarray:
        return (118.0 + 2.0 * rng.standard_normal(image.shape)).astype(np.uint8)

    air = take_off(tmp_path, seconds=SECONDS, camera=on_pictures(water))
    holds(air, "featureless", "poor fit")


class FullDisk:
    """A file system of a few hundred kilobytes, so far as the recorder can tell: writes fail while `is_full`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.is_full = False
        write = SessionRecorder._write

        def perhaps(recorder: SessionRecorder, *arguments: object) -> None:
            if self.is_full:
                raise InputError(f"recording {recorder.path}: No space left on device")
            write(recorder, *arguments)

        monkeypatch.setattr(SessionRecorder, "_write", perhaps)


@pytest.mark.long  # short, without a daemon: two full disks of tests/onboard/storage/test_rotating_recorder.py
def test_a_full_disk_stops_the_recording_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, begin_s, end_s = FullDisk(monkeypatch), 6.0, 10.0

    class Filler:
        """Fills the disk when its time has come, seen from the pipeline's thread."""

        def __init__(self) -> None:
            self.pictures = 0

        def __enter__(self) -> Filler:
            return self

        def __exit__(self, *_: object) -> None:
            return None

        def event(self, arrival_ns: int, event: Event) -> None:
            self.pictures += isinstance(event, Frame)
            disk.is_full = begin_s * 4 <= self.pictures < end_s * 4

        def feature_set(self, output: object) -> None:
            return None

    air = take_off(tmp_path, seconds=end_s + 8.0, sinks=lambda: [Filler()])
    assert air.code == 0
    assert air.first("not recording", begin_s - 0.5) < begin_s + SEEN_S
    assert air.first("ok", end_s) < end_s + 5.0 + 2.0  # Recorded looks again after five seconds
    outcome = air.clicked()
    assert outcome.solved > 0.95, outcome.reported
    assert outcome.inside_99 > 0.97, outcome.reported
    assert len(air.recordings) == 2
    assert Recording(air.recordings[1]).frames("uav")[0] == 0  # any part stands for the session
    whole, incomplete = (b"complete" + len(word).to_bytes(4, "little") + word for word in (b"yes", b"no"))
    before, after = (path.read_bytes() for path in air.recordings)
    assert whole in before and incomplete in after  # a replay will say that events are missing
