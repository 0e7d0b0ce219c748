"""What is wrong on a flight: pictures spoilt by lens, air, compression or camera, telemetry lost, stamps cut."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from contract.geodesy import LocalFrame
from onboard.events.types import Event, GpsQuality
from onboard.geometry.terrain_grid import Terrain
from onboard.vision.contrast_normalisation import Picture
from tests.scenarios.flights import copied, retouched

Change = Callable[[Picture], Picture]
Spoil = Callable[[Event, float], Event | None]


def pictures(change: Change, begin: int = 0, end: int | None = None) -> Callable[[Path], Path]:
    """A session of which pictures are changed: all, or those from one to before another."""
    return partial(retouched, change=change, frames=None if end is None else range(begin, end))


def picture(image: object) -> Picture:
    return np.clip(np.asarray(image), 0, 255).astype(np.uint8)


def blur(sigma_px: float) -> Change:
    return lambda image: picture(cv2.GaussianBlur(image, (0, 0), sigma_px))


def smeared_along(length_px: int, is_upright: bool) -> Change:
    kernel = np.full((length_px, 1) if is_upright else (1, length_px), 1.0 / length_px)
    return lambda image: picture(cv2.filter2D(image, -1, kernel))


def jpeg(quality: int) -> Change:
    def encoded(image: Picture) -> Picture:
        done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        assert done
        return picture(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))

    return encoded


def fog(image: Picture) -> Picture:
    return picture(np.rint(0.05 * image + 142.0))


def dirt(image: Picture) -> Picture:
    """A smear on the lens: a third of the picture blurred and brightened, always the same third."""
    height, width = image.shape
    rows, columns = np.mgrid[:height, :width]
    spot = np.exp(-((columns - 0.3 * width) ** 2 + (rows - 0.4 * height) ** 2) / (0.2 * width) ** 2)
    return picture((1.0 - spot) * image + spot * (20.0 + 0.8 * cv2.GaussianBlur(image, (0, 0), 10.0)))


black: Change = np.zeros_like
defocused = blur(8.0)


def white(image: Picture) -> Picture:
    return np.full_like(image, 255)


def without_fix(is_lost: Callable[[float], bool]) -> Spoil:
    return lambda event, t: replace(event, fix_type=1) if isinstance(event, GpsQuality) and is_lost(t) else event


def silence(is_silent: Callable[[float], bool]) -> Spoil:
    return lambda event, t: None if is_silent(t) else event


def between(apart_s: float, begin: float, end: float) -> Callable[[float], bool]:
    """The times within these shares of the time between two pictures."""
    return lambda t: begin < (t % apart_s) / apart_s < end


def cut_to_the_second(folder: Path) -> Path:
    copy = copied(folder)
    header, *rows = (copy / "stamps.csv").read_text().splitlines()
    cut = [f"{name},{int(float(stamp))}" for name, stamp in (row.split(",") for row in rows)]
    (copy / "stamps.csv").write_text("\n".join([header, *cut]) + "\n")
    return copy


class LevelTerrain:
    """An elevation model that is right: level at the simulated ground's height."""

    def __init__(self, height_amsl_m: float = 100.0) -> None:
        self.height_amsl_m = height_amsl_m

    def around(
        self, frame: LocalFrame, centre_enu_m: np.ndarray, radius_m: float, spacing_m: float, undulation_m: float
    ) -> Terrain:
        n = 2 * int(radius_m / spacing_m) + 1
        west, south = centre_enu_m[:2] - radius_m
        return Terrain(west, south, spacing_m, np.full((n, n), self.height_amsl_m - frame.height_m))
