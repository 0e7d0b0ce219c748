"""The look of the ground: a brightness at every ground point, generated from a seed, that does not repeat.

Periodic pictures of incommensurate periods and bearings are added: grain at two sizes (grass and stones), land (fields,
hedges, tracks, shrubs) and country (broad patches of hundreds of metres). Each is kept as an image pyramid and
sampled at the level that fits the pixel's footprint on the ground, so that a feature looks the same from frame to frame
instead of twinkling.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from simulation.kept_drawings import kept
from simulation.patterns import (
    STRIPE_TEXELS,
    draw_country,
    draw_grain,
    draw_gusts,
    draw_land,
    draw_stripes,
    draw_vehicles,
    draw_wave_train,
    draw_waves,
)

Array = NDArray[np.float64]
Image = NDArray[np.float32]

MEAN_ALBEDO = 0.30
MIN_WEIGHT = 0.02
VEHICLE_M_S = np.array([11.0, 4.0])
STYLES = ("land", "water", "sea", "stripes", "plain", "traffic", "crops")
SEA_WAVELENGTHS_M = (1.4, 2.2, 3.5, 5.5, 9.0, 14.0)
GRAVITY_M_S2 = 9.81
# Of crops in a wind: how fast its gusts go over them, how far they bend the ears (one sigma, m), and how much brighter
# or darker what is bent is.
GUSTS_M_S, GUST_TEXEL_M = np.array([3.2, -2.4]), 0.5
SWAY_M, SHINE = 0.03 * np.array([0.8, -0.6]), 0.03


@dataclass(frozen=True)
class TextureSpec:
    """`style`: "land"; "water" (two patterns of waves that move through each other); "sea" (waves of many lengths
    before one wind, each at its own speed); "stripes" (rows `row_spacing_m` apart that repeat exactly); "plain"
    (nothing to track); "traffic" (land, with vehicles, one in `vehicle_spacing_m` of each lane: on a twentieth of it);
    "crops" (land that sways and shines in waves of some metres, as crops do below the gusts of a wind).

    `contrast` scales every brightness difference: 1 is pasture in sunlight, 0.1 is snow under cloud.
    """

    style: str = "land"
    contrast: float = 1.0
    seed: int = 0
    vehicle_spacing_m: int = 64
    row_spacing_m: float = 8.0

    def __post_init__(self) -> None:
        if self.style not in STYLES:
            raise InputError(f"texture {self.style!r} is not known; use one of {', '.join(STYLES)}")
        if not 0.0 <= self.contrast <= 3.0:
            raise InputError(f"texture contrast {self.contrast} must lie between 0 and 3")
        if self.vehicle_spacing_m not in (16, 32, 64, 128):
            raise InputError(f"vehicle spacing {self.vehicle_spacing_m} m must be 16, 32, 64 or 128")
        if not 0.2 <= self.row_spacing_m <= 50.0:
            raise InputError(f"row spacing {self.row_spacing_m} m must lie between 0.2 and 50")


class Tile:
    """One periodic picture laid over the ground at a bearing, with its pyramid."""

    def __init__(self, picture: Image, texel_m: float, bearing_rad: float) -> None:
        self.texel_m = texel_m
        self.period_m = texel_m * picture.shape[0]
        self.bearing_rad = bearing_rad
        self._cos, self._sin = float(np.cos(bearing_rad)), float(np.sin(bearing_rad))
        self._levels = [picture]
        while self._levels[-1].shape[0] > 16:
            last = cv2.copyMakeBorder(self._levels[-1], 4, 4, 4, 4, cv2.BORDER_WRAP)
            # Texel 2i of one level is texel i of the next: pyrDown keeps the centres of even texels.
            self._levels.append(np.ascontiguousarray(cv2.pyrDown(last)[2:-2, 2:-2], dtype=np.float32))

    def add_to(self, total: Image, origin_m: Array, x_m: Image, y_m: Image, footprint_m: Image) -> None:
        """Add the picture's values at ground points `origin_m` (2,) + (x_m, y_m) (H, W) seen at that footprint."""
        # A whole number of periods is taken off in double precision: single precision is then good to micrometres.
        u0 = (self._cos * origin_m[0] + self._sin * origin_m[1]) % self.period_m
        v0 = (-self._sin * origin_m[0] + self._cos * origin_m[1]) % self.period_m
        u = (x_m * np.float32(self._cos) + y_m * np.float32(self._sin) + np.float32(u0)) * np.float32(1 / self.texel_m)
        v = (y_m * np.float32(self._cos) - x_m * np.float32(self._sin) + np.float32(v0)) * np.float32(1 / self.texel_m)
        level_of = np.log2(np.maximum(footprint_m * np.float32(0.75 / self.texel_m), np.float32(1.0)))
        top = len(self._levels) - 1
        np.minimum(level_of, np.float32(top), out=level_of)
        first, last = int(np.floor(level_of.min())), int(np.ceil(level_of.max()))
        for level in range(first, last + 1):
            weight = np.maximum(np.float32(1.0) - np.abs(level_of - np.float32(level)), np.float32(0.0))
            if float(weight.max()) < MIN_WEIGHT:
                continue
            # A view of the horizon has one level far away and another close by.
            weighty = np.flatnonzero(weight.max(axis=1))
            at = slice(int(weighty[0]), int(weighty[-1]) + 1)
            picture, scale = self._levels[level], np.float32(0.5**level)
            limit = np.float32(30000.0)  # cv2.remap keeps whole texels in 16 bits; only haze lies further out
            columns = _wrapped(np.clip(u[at] * scale, -limit, limit), picture.shape[1])
            rows = _wrapped(np.clip(v[at] * scale, -limit, limit), picture.shape[0])
            total[at] += weight[at] * cv2.remap(picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def _wrapped(texels: Image, size: int) -> Image:
    """The same places (H, W) of a periodic picture, less than its size from its origin.

    cv2.remap looks up what lies within its picture five times as fast as what lies beyond. Nothing is rounded: sizes
    are powers of two, and no place changes its side of the origin, near which single precision is finest.
    """
    out: Image = texels - np.float32(size) * np.trunc(texels * np.float32(1.0 / size))
    return out


@dataclass(frozen=True, eq=False)
class Layer:
    """A tile and the velocity (2,), m/s, at which it moves over the ground: zero but for water."""

    tile: Tile
    velocity_m_s: Array


@lru_cache(maxsize=4)
def _layers(style: str, seed: int, row_spacing_m: float) -> tuple[Layer, ...]:
    """Drawing land takes three seconds; the last four grounds are kept, of 73 MB at most."""
    rng = np.random.default_rng([seed, 202])
    bearing = rng.uniform(0.0, 2.0 * np.pi, 4)
    still = np.zeros(2)
    if style == "land":
        grains = kept(f"land-{seed}", lambda: [draw_grain(rng), draw_grain(rng), draw_land(rng), draw_country(rng)])
        texels_m, bearings = (0.061, 0.17, 0.31, 2.3), bearing[[3, 0, 1, 2]]
        return tuple(Layer(Tile(*tile), still) for tile in zip(grains, texels_m, map(float, bearings), strict=True))
    if style == "water":
        wave = draw_waves(rng)
        return (
            Layer(Tile(wave, 0.23, bearing[0]), np.array([2.1, 0.9])),
            Layer(Tile(wave, 0.37, bearing[1]), np.array([-1.7, 1.3])),
        )
    if style == "sea":
        # Steepness is the same at all lengths; what is seen of a wave is its slope. Deep water: speed by length alone.
        downwind = bearing[0] + rng.normal(0.0, 0.35, len(SEA_WAVELENGTHS_M))
        speed = np.sqrt(GRAVITY_M_S2 * np.array(SEA_WAVELENGTHS_M) / (2.0 * np.pi))
        heading = np.stack([np.cos(downwind), np.sin(downwind)], axis=1)
        trains = (np.float32(0.025) * draw_wave_train(rng, 10.0) for _ in SEA_WAVELENGTHS_M)
        return tuple(
            Layer(Tile(train, length_m / 10.0, float(course)), velocity)
            for train, length_m, course, velocity in zip(
                trains, SEA_WAVELENGTHS_M, downwind, speed[:, None] * heading, strict=True
            )
        )
    if style == "stripes":
        return (Layer(Tile(draw_stripes(), row_spacing_m / STRIPE_TEXELS, bearing[0]), still),)
    return ()


@lru_cache(maxsize=1)
def _traffic(seed: int, spacing: int) -> tuple[Tile, Tile]:
    """Positions and brightness of vehicles, in lanes along their motion, one in `spacing` texels."""
    bearing = float(np.arctan2(VEHICLE_M_S[1], VEHICLE_M_S[0]))
    where, paint = draw_vehicles(np.random.default_rng([seed, 203]), spacing)
    return Tile(where, 0.25, bearing), Tile(paint, 0.25, bearing)


@lru_cache(maxsize=1)
def _gusts(seed: int) -> Tile:
    """The field of how far crops are bent, which a wind carries over them."""
    return Tile(draw_gusts(np.random.default_rng([seed, 204])), GUST_TEXEL_M, 0.0)


class Texture:
    """The brightness of the ground."""

    def __init__(self, spec: TextureSpec) -> None:
        self.spec = spec
        style = "land" if spec.style in ("traffic", "crops") else spec.style
        self.layers = _layers(style, spec.seed, spec.row_spacing_m)
        self.gusts = _gusts(spec.seed) if spec.style == "crops" else None
        self.traffic = _traffic(spec.seed, 4 * spec.vehicle_spacing_m) if spec.style == "traffic" else None

    def albedo(self, origin_m: Array, x_m: Image, y_m: Image, footprint_m: Image, time_s: float = 0.0) -> Image:
        """Reflectance (H, W), 0.02 to 0.98, of the ground at `origin_m` (2,) + (`x_m`, `y_m`) in ENU metres."""
        total: Image = np.zeros(x_m.shape, np.float32)
        if self.gusts is not None:
            bent = np.zeros_like(total)
            self.gusts.add_to(bent, origin_m - GUSTS_M_S * time_s, x_m, y_m, footprint_m)
            total = total + np.float32(SHINE) * bent
            x_m, y_m = (at - np.float32(by) * bent for at, by in zip((x_m, y_m), SWAY_M, strict=True))
        for layer in self.layers:
            layer.tile.add_to(total, origin_m - layer.velocity_m_s * time_s, x_m, y_m, footprint_m)
        total *= np.float32(self.spec.contrast)
        total += np.float32(MEAN_ALBEDO)
        if self.traffic is not None:
            at = origin_m - VEHICLE_M_S * time_s
            where, paint = np.zeros_like(total), np.zeros_like(total)
            self.traffic[0].add_to(where, at, x_m, y_m, footprint_m)
            self.traffic[1].add_to(paint, at, x_m, y_m, footprint_m)
            total = total * (np.float32(1.0) - where) + paint
        return np.clip(total, np.float32(0.02), np.float32(0.98), out=total)
