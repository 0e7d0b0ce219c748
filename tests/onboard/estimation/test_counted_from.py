"""Estimates are of the mount, clocks, camera and vehicle that were declared then, and serve no others.

In sampled flights the lens kept from a camera of half the size put clicks 56 m off, 8.5 ellipses (median), that of
another lens 17 to 27 m; both are 2 to 4 m now.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from contract.camera import Camera
from contract.errors import InputError
from contract.rotations import exp_so3, mount_rotation
from onboard.config.schema import Config, parse_config
from onboard.estimation.boresight import Alignment
from onboard.estimation.camera_states import corrected
from onboard.estimation.counted_from import CountedFrom
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, STATES, VELOCITY_DELAY
from onboard.estimation.sliding_window import Window

CAMERA = replace(Camera.from_field_of_view(640, 480, 40.0), stated_sigma=(0.01, 0.005, 0.005, 0.02, 0.02))
FOUND = np.array([0.03, -0.01, 0.005, 0.08, 0.05, 0.04, 0.02, -0.01, 0.012, 0.0, 0.0, 0.0, 0.0])
SHARE = 0.1  # of the first sigma that is left


def learned() -> str:
    """The state of a session that has found `FOUND` of `CAMERA` on the mount straight down."""
    alignment = Window(Config(), CAMERA).alignment
    covariance = np.diag((SHARE * alignment.platform.sigma) ** 2)
    for end_ns in (10**10, 10**12):  # the second confirms the first
        alignment.offer(end_ns - 10**10, end_ns, FOUND, covariance)
    assert alignment.platform.mean == pytest.approx(FOUND, rel=0.02, abs=1e-4)
    return alignment.to_json()


def restored(config: str = "", camera: Camera = CAMERA) -> tuple[Alignment, tuple[str, ...]]:
    alignment = Window(parse_config(config), camera).alignment
    return alignment, alignment.restore(learned())


def begins_again(alignment: Alignment, at: slice | int) -> None:
    """Hold a state to its declaration, no surer than declared."""
    first = Window(Config(), CAMERA).alignment.platform
    assert np.all(alignment.platform.mean[at] == 0.0)
    assert np.all(alignment.platform.sigma[at] > first.sigma[at])


def is_as_found(alignment: Alignment, at: slice | int) -> None:
    assert alignment.platform.mean[at] == pytest.approx(FOUND[at], rel=0.02, abs=1e-4)


def test_what_is_declared_as_before_goes_on_as_it_was_found() -> None:
    alignment, left_out = restored()
    assert left_out == ()
    is_as_found(alignment, slice(None))


@pytest.mark.parametrize(
    "camera",
    [
        Camera.from_field_of_view(1280, 960, 40.0),  # the same lens at twice the size
        Camera.from_field_of_view(480, 640, 40.0),  # turned by 90 degrees
        Camera.from_field_of_view(640, 480, 50.0),
        Camera.from_field_of_view(640, 480, 41.5),
    ],
)
def test_another_camera_has_its_own_lens_mount_and_time_offset(camera: Camera) -> None:
    alignment, left_out = restored(camera=replace(camera, stated_sigma=CAMERA.sigma))
    for at in (BORESIGHT, OFFSET, slice(STATES, None)):
        begins_again(alignment, at)
    for at in (DELAY, VELOCITY_DELAY, HEADING):
        is_as_found(alignment, at)
    assert left_out == ("boresight", "time offset", "focal length", "principal point", "distortion")


def test_another_camera_that_is_known_for_sure_is_another_camera_too() -> None:
    sure = Camera.from_field_of_view(640, 480, 50.0)
    alignment, left_out = restored(camera=sure)
    begins_again(alignment, BORESIGHT)
    begins_again(alignment, OFFSET)
    assert "boresight" in left_out


def test_a_file_that_was_set_right_leaves_nothing_to_correct() -> None:
    better = replace(corrected(CAMERA, FOUND[STATES:]), stated_sigma=CAMERA.sigma)
    alignment, left_out = restored(camera=better)
    assert left_out == ()
    assert alignment.platform.mean[STATES:] == pytest.approx(np.zeros(5), abs=3e-4)
    is_as_found(alignment, slice(0, STATES))


def test_a_mount_that_was_set_right_is_not_corrected_twice() -> None:
    """Or it would be off by what was found, and the more surely so."""
    before = CountedFrom.of(Config(), CAMERA, mount_rotation(0.0, -90.0, 0.0))
    now = replace(before, R_body_cam=before.R_body_cam @ exp_so3(FOUND[BORESIGHT]))
    sigma = np.full(len(FOUND), 0.002)
    states, is_lost = now.recounted(json.loads(json.dumps(before.as_numbers())), FOUND, sigma)
    assert states[BORESIGHT] == pytest.approx(np.zeros(3), abs=1e-9)
    assert not is_lost.any()


def test_another_mount_begins_again() -> None:
    alignment, left_out = restored("[mount]\npitch_deg = -60.0")
    assert left_out == ("boresight",)
    begins_again(alignment, BORESIGHT)
    is_as_found(alignment, slice(OFFSET, None))


def test_latencies_that_were_set_right_or_are_others() -> None:
    alignment, left_out = restored("[camera]\nlatency_s = -0.08\n[gps]\nlatency_s = 0.09")
    assert left_out == ()
    assert alignment.platform.mean[[OFFSET, DELAY]] == pytest.approx(np.zeros(2), abs=0.002)
    alignment, left_out = restored("[camera]\nlatency_s = 0.2\n[gps]\nlatency_s = 0.3")
    assert left_out == ("time offset", "position delay", "velocity delay")
    begins_again(alignment, slice(OFFSET, VELOCITY_DELAY + 1))
    is_as_found(alignment, BORESIGHT)


def test_of_another_vehicle_nothing_is_taken() -> None:
    alignment, _ = restored('[vehicle]\nid = "another"')
    begins_again(alignment, slice(None))


@pytest.mark.parametrize("counted_from", [[], {}, {"vehicle": "uav"}, 3, "x", {"vehicle": "uav", "R_body_cam": [1]}])
def test_what_it_was_counted_from_is_read_or_refused_by_name(counted_from: object) -> None:
    content = json.loads(learned()) | {"counted_from": counted_from}
    del content["crc32"]
    with pytest.raises(InputError, match="counted_from is not readable"):
        Window(Config(), CAMERA).alignment.restore(json.dumps(content))
