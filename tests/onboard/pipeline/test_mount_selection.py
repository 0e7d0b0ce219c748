"""The mount hypothesis is selected by reprojection error: the true one wins, and none where nothing shows which."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import R_ENU_NED, matrix_from_euler, mount_rotation
from onboard.navigation.gimbal import MountHypothesis
from onboard.navigation.navigator import NavState
from onboard.pipeline.mount_selection import MountSelection

Array = NDArray[np.float64]
CAMERA = Camera.from_field_of_view(640, 480, 40.0)
DOWN = mount_rotation(0.0, -90.0, 0.0)
R_BODY_GIMBAL = matrix_from_euler(0.0, -np.pi / 2, 0.0)
HEIGHT_M = 250.0


def body(t: float, wobble_rad: float) -> Array:
    """R_ned_body of a vehicle that sways as it flies north."""
    return matrix_from_euler(wobble_rad * np.sin(1.3 * t), 0.6 * wobble_rad * np.sin(0.9 * t + 1.0), 0.1)


def state(t: float, wobble_rad: float, joints: Array, speed_m_s: float = 20.0) -> NavState:
    """A gimbal that says `joints` (3, 3): R_ref_gimbal, its yaw from the nose."""
    R_ned_body = body(t, wobble_rad)
    readings = {
        MountHypothesis.MOUNT: R_ned_body,
        MountHypothesis.GIMBAL: matrix_from_euler(0.0, 0.0, 0.1) @ joints @ R_BODY_GIMBAL.T,
        MountHypothesis.JOINTS: R_ned_body @ joints @ R_BODY_GIMBAL.T,
    }
    mount_hypotheses = {c: R_ENU_NED @ R for c, R in readings.items()}
    here = np.array([0.0, speed_m_s * t, HEIGHT_M])
    return NavState(
        round(t * 1e9),
        here,
        None,
        mount_hypotheses[MountHypothesis.MOUNT],
        1.5,
        2.5,
        0.3,
        0.0,
        HEIGHT_M,
        mount_hypotheses=mount_hypotheses,
    )


def pictures(
    truth: MountHypothesis, joints_of: str, count: int, wobble_rad: float = 0.1, speed_m_s: float = 20.0
) -> tuple[MountSelection, int | None]:
    """A selection after `count` pictures at 5 Hz against a keyframe a second; and at which picture it decided."""
    rng = np.random.default_rng(3)
    mount_selection = MountSelection(DOWN)
    decided = None
    was: NavState | None = None
    for k in range(count):
        t = 0.2 * k
        held = {  # what the message says
            "level": matrix_from_euler(0.0, -np.pi / 2, 0.0),  # stabilised, and said against the horizon
            "joints": body(t, wobble_rad).T @ matrix_from_euler(0.0, 0.0, 0.1) @ R_BODY_GIMBAL,  # said against the body
            "forward": np.eye(3),
        }[joints_of]
        now = state(t, wobble_rad, held, speed_m_s)
        if was is None or k % 5 == 0:
            was = now
            continue
        uv = rng.uniform(0.05, 0.95, (100, 2)) * (CAMERA.width_px, CAMERA.height_px)
        R_was, R_now = ((n.mount_hypotheses[truth] @ DOWN).T for n in (was, now))
        rays, _ = CAMERA.unproject(uv)
        rays_enu = rays @ R_was
        height = HEIGHT_M * rng.uniform(0.97, 1.03, len(uv))  # ground roughness
        points = was.position_enu_m - rays_enu * (height / rays_enu[:, 2])[:, None]
        to, seen = CAMERA.project((points - now.position_enu_m) @ R_now.T)
        to_px = to[seen] + rng.normal(0.0, 0.3, (int(seen.sum()), 2))
        mount_selection.weigh(CAMERA, was, now, np.zeros(3), uv[seen], to_px)
        if mount_selection.verdict is not None and decided is None:
            decided = k
    return mount_selection, decided


@pytest.mark.parametrize(
    ("truth", "reported"),
    [
        (MountHypothesis.GIMBAL, "level"),
        (MountHypothesis.JOINTS, "joints"),  # a stabilised camera whose messages are joint angles
        (MountHypothesis.MOUNT, "joints"),  # the same messages beside a fixed camera: ArduPilot's simulator
        (MountHypothesis.MOUNT, "forward"),  # a mount that is configured and not there
        (MountHypothesis.MOUNT, "level"),
    ],
)
@pytest.mark.parametrize("speed_m_s", [20.0, 0.0])
def test_the_reading_that_foretells_the_pictures_wins(truth: MountHypothesis, reported: str, speed_m_s: float) -> None:
    mount_selection, decided = pictures(truth, reported, 60, speed_m_s=speed_m_s)
    assert mount_selection.verdict is truth
    assert 2 < decided < 40


def test_readings_that_look_alike_are_not_told_apart_and_need_not_be() -> None:
    """A camera that points down from a vehicle that never tilts."""
    mount_selection, decided = pictures(MountHypothesis.MOUNT, "level", 60, wobble_rad=0.0)
    assert decided is None
    assert not mount_selection.is_open(state(1.0, 0.0, matrix_from_euler(0.0, -np.pi / 2, 0.0)))


def test_it_is_open_only_while_readings_differ_and_none_is_found() -> None:
    down = matrix_from_euler(0.0, -np.pi / 2, 0.0)
    mount_selection = MountSelection(DOWN)
    assert mount_selection.is_open(state(1.0, 0.2, down))
    assert not mount_selection.is_open(replace(state(1.0, 0.2, down), mount_hypotheses={}))
    decided, _ = pictures(MountHypothesis.MOUNT, "forward", 60)
    assert not decided.is_open(state(1.0, 0.2, np.eye(3)))
