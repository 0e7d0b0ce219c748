"""A gimbal's attitude in place of the fixed mount's, in both ways that gimbals count their yaw."""

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import R_ENU_NED, log_so3, matrix_from_euler, mount_rotation, quaternion_from_matrix
from onboard.config.schema import Config, parse_config
from onboard.events.types import Attitude, GimbalAttitude, PositionFix
from onboard.navigation.navigator import Navigation, NavState

Array = NDArray[np.float64]
T0 = 1_795_217_000_000_000_000
MOUNT = (2.0, -60.0, 15.0)  # configured, and not how the gimbal hangs
CONFIG = parse_config(
    "[mount]\ngimbal = 'always'\nroll_deg = 2.0\npitch_deg = -60.0\nyaw_deg = 15.0\n[gps]\nlatency_s = 0.0"
)


def heading(t: float) -> float:
    return 3.0 + 0.4 * t  # passes +-pi


def gimbal_from_nose(t: float) -> Array:
    return matrix_from_euler(0.02, -1.2 + 0.05 * t, 0.3)


def R_ned_cam(t: float) -> Array:
    return matrix_from_euler(0.0, 0.0, heading(t)) @ gimbal_from_nose(t) @ mount_rotation(0.0, 0.0, 0.0)


def flown(
    reference: str, until_s: float = 3.0, config: Config = CONFIG, vehicle: bool = True, own: bool = False
) -> Navigation:
    navigation = Navigation(config)
    for t in np.arange(0.0, 3.0, 0.1):
        stamp_ns = T0 + round(t * 1e9)
        navigation.add(PositionFix(stamp_ns, -43.38, 172.4, 300.0, (0.0, 0.0, 0.0)))
        if vehicle:
            q = quaternion_from_matrix(matrix_from_euler(0.25, 0.1, heading(t)))
            navigation.add(Attitude(stamp_ns, tuple(q.tolist())))
        R = gimbal_from_nose(t)
        if reference == "earth":
            R = matrix_from_euler(0.0, 0.0, heading(t)) @ R
        if t < until_s:
            q = tuple(quaternion_from_matrix(R).tolist())
            navigation.add(GimbalAttitude(stamp_ns, q, "earth" if reference == "earth" else "vehicle", own))
    return navigation


def camera_miss_deg(state: NavState | Status, t: float) -> float:
    seen = R_ENU_NED.T @ state.R_enu_body @ mount_rotation(*MOUNT)
    return float(np.degrees(np.linalg.norm(log_so3(seen.T @ R_ned_cam(t)))))


@pytest.mark.parametrize("reference", ["earth", "vehicle"])
@pytest.mark.parametrize("t", [0.5, 1.23, 2.75])
def test_the_camera_looks_where_the_gimbal_points_whatever_the_mount_says(reference: str, t: float) -> None:
    assert camera_miss_deg(flown(reference).state_at(T0 + round(t * 1e9)), t) < 0.05


def test_angles_that_the_camera_itself_wrote_leave_nothing_open() -> None:
    """Of subtitles and photographs: with 'auto' the same as with 'always', from the first picture on."""
    auto, never = (
        parse_config(
            f"[mount]\ngimbal = '{setting}'\nroll_deg = 2.0\npitch_deg = -60.0\nyaw_deg = 15.0\n[gps]\nlatency_s = 0.0"
        )
        for setting in ("auto", "never")
    )
    state = flown("earth", config=auto, own=True).state_at(T0 + 500_000_000)
    assert camera_miss_deg(state, 0.5) < 0.05
    assert not state.mount_hypotheses
    # What an autopilot passes on may be of another camera, or of none: the pictures decide.
    other = flown("earth", config=auto).state_at(T0 + 500_000_000)
    assert len(other.mount_hypotheses) == 2 and camera_miss_deg(other, 0.5) > 5.0
    assert camera_miss_deg(flown("earth", config=never, own=True).state_at(T0 + 500_000_000), 0.5) > 5.0


def test_a_gimbal_against_the_earth_needs_no_attitude_of_the_vehicle() -> None:
    navigation = flown("earth", vehicle=False)
    assert camera_miss_deg(navigation.state_at(T0 + 1_500_000_000), 1.5) < 0.05


def test_a_gimbal_that_counts_from_the_nose_is_nothing_without_a_heading() -> None:
    state = flown("vehicle", vehicle=False).state_at(T0 + 1_500_000_000)
    assert state.R_enu_body is None


@pytest.mark.parametrize("reference", ["earth", "vehicle"])
def test_the_rate_is_the_cameras_not_the_vehicles(reference: str) -> None:
    navigation = flown(reference)
    rate = navigation.body_rate_at(T0 + 1_500_000_000)
    h = 1e-4
    expected = log_so3(R_ned_cam(1.5 - h).T @ R_ned_cam(1.5 + h)) / (2 * h)
    np.testing.assert_allclose(mount_rotation(*MOUNT).T @ rate, expected, atol=0.01)
    assert np.linalg.norm(expected) > 0.3


def test_a_gimbal_that_falls_silent_is_a_gap_and_no_return_to_the_fixed_mount() -> None:
    navigation = flown("earth", until_s=1.0)
    assert isinstance(navigation.state_at(T0 + 850_000_000), NavState)
    state = navigation.state_at(T0 + 2_500_000_000)
    assert state.R_enu_body is None and not state.mount_hypotheses
    assert navigation.covers(T0 + 2_500_000_000)  # what came now could not be joined with what came last
    assert not navigation.covers(T0 + 3_500_000_000)


def test_a_gimbal_can_be_ignored() -> None:
    ignoring = parse_config("[mount]\ngimbal = 'never'\n[gps]\nlatency_s = 0.0")
    state = flown("earth", config=ignoring).state_at(T0 + 1_500_000_000)
    R_ned_body = R_ENU_NED.T @ state.R_enu_body
    assert np.linalg.norm(log_so3(R_ned_body.T @ matrix_from_euler(0.25, 0.1, heading(1.5)))) < 1e-3


def test_a_gimbal_that_changes_what_it_counts_from_starts_anew() -> None:
    navigation = flown("earth")
    for t in np.arange(3.0, 5.0, 0.1):
        stamp_ns = T0 + round(t * 1e9)
        navigation.add(PositionFix(stamp_ns, -43.38, 172.4, 300.0, (0.0, 0.0, 0.0)))
        navigation.add(Attitude(stamp_ns, tuple(quaternion_from_matrix(matrix_from_euler(0, 0, heading(t))).tolist())))
        navigation.add(GimbalAttitude(stamp_ns, tuple(quaternion_from_matrix(gimbal_from_nose(t)).tolist()), "vehicle"))
    assert camera_miss_deg(navigation.state_at(T0 + 4_210_000_000), 4.21) < 0.05
