"""A clicked pixel is measured in a recording as on board, also where pictures are damaged or missing."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from contract.feature_set import ClickedPixel, FeatureSet, Measured
from onboard.events.kept_pictures import Kept
from onboard.events.types import Frame
from onboard.measured.question import Questions
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_writer import SessionRecorder
from onboard.storage.recorded_pictures import RecordedPictures
from tests.onboard.measured.step_world import CAMERA, CLICKED, EPOCH_NS, World
from tests.rest_long import rest_long

WORLD = World(roof_m=8.0, seed=12)
ROOF = (200.0, 85.0)


def recorded(path: Path, world: World = WORLD, pictures: str = "lossless") -> Path:
    """Nine pictures, whose sets come one picture late, each after a first revision that was worse."""
    with SessionRecorder(path, "uav-1", camera_json=CAMERA.to_json(), pictures=pictures) as out:
        for number in range(9):
            out.write_event(Frame(EPOCH_NS + number * 10**9, number, world.image(number)))
            its_set = world.its_set(number)
            out.write_set(revised(its_set, 1))
            out.write_set(revised(its_set, 0))  # late: not the one that counts
    return path


def revised(its_set: FeatureSet, revision: int) -> FeatureSet:
    off = 1.0 if revision else 1.02
    return replace(its_set, revision=revision, inverse_depth_per_m=its_set.inverse_depth_per_m * off)


@lru_cache(maxsize=8)
def opened(path: Path) -> RecordedPictures:
    return RecordedPictures(RecordedFlight.open([path]))


def measured(pictures: RecordedPictures, uv: tuple[float, float], questions: Questions | None = None) -> ClickedPixel:
    clicked, others = pictures.placed(5, CLICKED)
    asked = WORLD.its_set(CLICKED) if clicked is None else clicked.its_set
    pixel = (questions or Questions()).measured_set(asked, uv, clicked, others).clicked
    assert pixel is not None
    return pixel


def test_the_answer_is_the_aircraft_s_own_where_pictures_are_lossless(tmp_path: Path) -> None:
    pictures = opened(recorded(tmp_path / "a.mcap"))
    clicked, others = pictures.placed(5, CLICKED)
    assert clicked.its_set.revision == 1 and len(others) == len(pictures) - 1 == 8
    rest = [Kept(WORLD.image(one.its_set.frame), one.its_set) for one in others]
    live = Questions().measured_set(clicked.its_set, ROOF, Kept(WORLD.image(CLICKED), clicked.its_set), rest)
    assert measured(pictures, ROOF) == live.clicked and live.clicked.is_measured


@pytest.mark.parametrize("kind", rest_long(["jpeg", "lossless"]))
def test_errors_are_what_the_sigmas_state(kind: str, tmp_path: Path) -> None:
    pictures, questions, z = opened(recorded(tmp_path / "a.mcap", pictures=kind)), Questions(), []
    for uv in np.random.default_rng(4).uniform((30, 30), (290, 210), (40, 2)).round(1):
        pixel = measured(pictures, (float(uv[0]), float(uv[1])), questions)
        if pixel.is_measured:
            depth = float(WORLD.depths(CLICKED, np.array([pixel.u_px, pixel.v_px]))[0])
            z.append((pixel.inverse_depth_per_m * depth - 1.0) * pixel.inverse_depth_per_m / pixel.sigma_per_m)
    inside = np.mean(np.abs(z) < 1.645)
    assert len(z) >= 28 and inside >= 0.7 and np.median(np.abs(z)) > 0.1


def test_what_is_damaged_or_not_there_is_done_without(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.mcap", pictures="jpeg")
    content = bytearray(path.read_bytes())
    starts = [at for at in range(len(content)) if content.startswith(b"/9j/", at)]  # of JPEGs in base64
    assert len(starts) == 9
    content[starts[6] + 400 : starts[6] + 420] = b"!" * 20
    (tmp_path / "b.mcap").write_bytes(content)
    assert measured(opened(tmp_path / "b.mcap"), ROOF).is_measured  # by seven others
    content[starts[CLICKED] + 400 : starts[CLICKED] + 420] = b"!" * 20
    (tmp_path / "c.mcap").write_bytes(content)
    assert measured(opened(tmp_path / "c.mcap"), ROOF).measured is Measured.NO_PICTURE
    (tmp_path / "d.mcap").write_bytes(path.read_bytes()[: starts[CLICKED + 1]])  # cut off: its set is there
    assert len(opened(tmp_path / "d.mcap")) == CLICKED + 1 and measured(opened(tmp_path / "d.mcap"), ROOF).is_measured
    pictures = opened(path)
    assert pictures.placed(6, CLICKED) == pictures.placed(5, 99) == (None, [])
    with pytest.raises(InputError, match="holds no pictures"):
        RecordedFlight.open([recorded(tmp_path / "e.mcap", pictures="none")])


def test_of_the_pictures_that_were_read_only_so_many_bytes_are_kept(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.mcap")
    few = RecordedPictures(RecordedFlight.open([path]), kept_bytes=3 * 320 * 240)
    assert measured(few, ROOF) == measured(opened(path), ROOF)
    assert len(few._images) <= 3 and few._bytes <= 3 * 320 * 240
