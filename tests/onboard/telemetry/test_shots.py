"""When a camera's shutter was released, as logs and DJI's timestamp file have it."""

from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from onboard.telemetry.log_files import read_log
from onboard.telemetry.mrk_reader import read_mrk
from tests.onboard.telemetry.log_writers import SHUTTER_S, T0_S, moments, written


@pytest.mark.parametrize("kind", ["bin", "tlog", "ulg"])
def test_shots_are_on_the_log_s_own_clock(tmp_path: Path, kind: str) -> None:
    """ArduPilot's CAM before TRIG, CAMERA_FEEDBACK whose UTC is not the log's clock, PX4's captures that succeeded."""
    shots_s = np.array(read_log(written(tmp_path, kind)).shots_ns) / 1e9
    taken_s = np.array([T0_S + moment.t + SHUTTER_S for moment in moments(1)])
    assert shots_s.shape == taken_s.shape and np.abs(shots_s - taken_s).max() < 0.03


def test_dji_s_timestamps_count_in_gps_weeks(tmp_path: Path, shared_data: Path) -> None:
    (first_ns,) = read_mrk(shared_data / "people_bring" / "DJI_Timestamp.MRK")[:1]
    assert first_ns == round((315_964_800 + 2097 * 604_800 - 18) * 1e9) + 270_245_350_537_000
    (tmp_path / "no.MRK").write_text("nothing\n")
    with pytest.raises(InputError, match="no line of a photograph"):
        read_mrk(tmp_path / "no.MRK")
