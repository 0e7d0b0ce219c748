"""One real autopilot's flight as its own log (.bin) and as a ground station's (.tlog), against truth."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink import DFReader

from contract.answer import Fix
from contract.camera import Camera
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.rotations import log_so3, matrix_from_euler, matrix_from_quaternion
from onboard.config.schema import Config
from onboard.events.types import Attitude, NavEvent, PositionFix
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight, replay
from onboard.telemetry.log_files import read_log
from onboard.telemetry.telemetry_log import TelemetryLog
from simulation.flight import RecordedSpec
from simulation.session import SessionSpec
from tests.onboard.telemetry.log_events import of
from tests.scenarios.flights import Outcome, _Sets, click, simulated

pytestmark = pytest.mark.xdist_group("plane log")  # one worker: what they share is made once

TRUTH_CLOCK_S = 1_795_300_000.0  # of boot time 0
START_S, SECONDS = 60.0, 14.0


@dataclass(frozen=True, eq=False)
class Logs:
    """Both on the truth's clock: the receiver's GPS time is another than the ground station's."""

    tlog: TelemetryLog
    bin: TelemetryLog


@pytest.fixture(scope="module")
def logs(shared_data: Path) -> Logs:
    folder = shared_data / "sitl"
    log = read_log(folder / "plane_log.bin")
    with DFReader.DFReader_binary(str(folder / "plane_log.bin")) as raw:
        first_s = raw.recv_match(type="POS").TimeUS * 1e-6
    shift_ns = round((TRUTH_CLOCK_S + first_s) * 1e9) - log.span_ns[0]
    events: list[NavEvent] = [replace(event, stamp_ns=event.stamp_ns + shift_ns) for event in log.events]
    return Logs(read_log(folder / "plane_log.tlog"), TelemetryLog.by_stamp(events))


@pytest.fixture(scope="module")
def truth(shared_data: Path) -> np.ndarray:
    return np.genfromtxt(shared_data / "sitl" / "plane_log.truth.csv", delimiter=",", skip_header=1)


def errors(log: TelemetryLog, truth: np.ndarray) -> tuple[float, float]:
    """Median error of positions (m), their delay taken as what fits best, and of attitudes (deg), in flight."""
    place = LocalFrame(*truth[len(truth) // 2, 1:4])
    true_enu, time = place.to_enu(truth[:, 1], truth[:, 2], truth[:, 3]), truth[:, 0] - TRUTH_CLOCK_S
    fixes = [f for f in of(log, PositionFix) if START_S < f.stamp_ns / 1e9 - TRUTH_CLOCK_S < time[-1] - 1.0]
    at = np.array([f.stamp_ns / 1e9 - TRUTH_CLOCK_S for f in fixes])
    enu = np.array([place.to_enu(f.lat_deg, f.lon_deg, f.height_amsl_m) for f in fixes])

    def miss_m(behind_s: float) -> float:
        true = np.stack([np.interp(at - behind_s, time, true_enu[:, i]) for i in range(3)], axis=-1)
        return float(np.median(np.linalg.norm(enu - true, axis=1)))

    turned = []
    for attitude in of(log, Attitude):
        row = int(np.argmin(np.abs(time - (attitude.stamp_ns / 1e9 - TRUTH_CLOCK_S))))
        if abs(time[row] - (attitude.stamp_ns / 1e9 - TRUTH_CLOCK_S)) < 0.004 and time[row] > START_S:
            R = matrix_from_euler(*np.radians(truth[row, 4:7]))
            turned.append(np.degrees(np.linalg.norm(log_so3(R.T @ matrix_from_quaternion(attitude.q_ned_body)))))
    assert len(fixes) > 300 and len(turned) > 100
    return min(miss_m(behind_s) for behind_s in np.arange(-0.1, 0.11, 0.02)), float(np.median(turned))


@pytest.mark.long
def test_both_logs_tell_the_flight_as_it_was_and_the_autopilot_s_own_no_worse(logs: Logs, truth: np.ndarray) -> None:
    by_tlog, by_bin = errors(logs.tlog, truth), errors(logs.bin, truth)
    # The GPS of this flight wanders by a metre, and the heading with the compass's offsets.
    assert 0.1 < by_bin[0] < 2.5 and 0.05 < by_bin[1] < 2.5
    assert by_bin[0] < by_tlog[0] + 0.1 and by_bin[1] < by_tlog[1] + 0.1


def test_the_autopilot_s_own_has_more_and_the_same_rates(logs: Logs) -> None:
    assert len(of(logs.bin, PositionFix)) > 2 * len(of(logs.tlog, PositionFix))
    theirs, ours = ([a for a in of(log, Attitude) if a.rate_body_rad_s] for log in (logs.tlog, logs.bin))
    at = [a.stamp_ns for a in theirs]
    ours = [a for a in ours if at[0] < a.stamp_ns < at[-1]]
    assert len(ours) > 2000
    for axis in range(3):
        same = np.interp([a.stamp_ns for a in ours], at, [a.rate_body_rad_s[axis] for a in theirs])
        own = np.array([a.rate_body_rad_s[axis] for a in ours])
        # Some milliseconds of the link part them, and the fastest rolls are between the link's messages.
        assert np.corrcoef(same, own)[0, 1] > 0.95 and abs(np.mean(same - own)) < 0.005


def test_the_simulator_s_truth_in_the_log_is_no_input(shared_data: Path, tmp_path: Path, logs: Logs) -> None:
    """Every byte of its SIM and SIM2 messages is overwritten: nothing that is read changes."""
    data = bytearray((shared_data / "sitl" / "plane_log.bin").read_bytes())
    with DFReader.DFReader_binary(str(shared_data / "sitl" / "plane_log.bin")) as raw:
        for name in ("SIM", "SIM2"):
            kind = raw.name_to_id[name]
            length = raw.formats[kind].len
            for at in raw.offsets[kind]:
                data[at + 11 : at + length] = bytes(length - 11)
    path = tmp_path / "blind.bin"
    path.write_bytes(bytes(data))
    blind = read_log(path)
    assert [repr(replace(e, stamp_ns=0)) for e in blind.events] == [
        repr(replace(e, stamp_ns=0)) for e in logs.bin.events
    ]


def answered(folder: Path, log: TelemetryLog) -> Outcome:
    config = Config.model_validate({"mount": {"gimbal": "never"}})
    camera = Camera.from_json(folder / "camera.json")
    flight = Flight.open(config, camera, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    pipeline, sink = Pipeline(config, camera), _Sets()
    replay(replace(flight, telemetry=log), pipeline, [sink])
    return click(folder, sink.by_frame, pipeline)


@pytest.mark.long
def test_both_logs_give_the_same_answers_within_their_sigmas(logs: Logs) -> None:
    camera = Camera.from_field_of_view(320, 240, 50.0)
    spec = SessionSpec(RecordedSpec("plane_log", start_s=START_S), seconds=SECONDS, rate_hz=4.0, camera=camera)
    folder = simulated(spec)
    by_tlog, by_bin = answered(folder, logs.tlog), answered(folder, logs.bin)
    for outcome in (by_tlog, by_bin):
        assert outcome.solved > 0.9, outcome.reported
        assert outcome.inside_99 >= 0.97, outcome.reported
    assert np.median(by_bin.errors_m) < 1.1 * np.median(by_tlog.errors_m) + 0.2, (by_tlog.reported, by_bin.reported)
    assert np.median(by_bin.semi_m) < 1.1 * np.median(by_tlog.semi_m), (by_tlog.reported, by_bin.reported)
    compared, far = 0, []
    for frame in sorted(by_tlog.sets)[::5]:
        one, other = (Locator(o.sets[frame]).locate((160.0, 120.0)) for o in (by_tlog, by_bin))
        if isinstance(one, Fix) and isinstance(other, Fix):
            place = LocalFrame(one.lat_deg, one.lon_deg, 0.0)
            apart = place.to_enu(other.lat_deg, other.lon_deg, 0.0)[:2]
            covariance = (one.covariance_enu_m2 + other.covariance_enu_m2)[:2, :2]
            compared += 1
            far.append(float(apart @ np.linalg.solve(covariance, apart)))
    assert compared >= 8
    assert max(far) < 9.21, far  # 99 % of two degrees of freedom
