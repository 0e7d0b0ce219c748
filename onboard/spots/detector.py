"""Spots of one picture, by their surroundings and by their heat alone. Section 25."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.thermal_scale import ThermalScale
from onboard.config.schema import SpotsConfig
from onboard.spots.clutter_tail import LARGEST, ClutterTail
from onboard.spots.contrast import Contrast, Image, contrast, in_picture
from onboard.spots.ground_scale import USUAL_M, GroundScale, ground_scale, usual_scale
from onboard.spots.ground_view import GroundView
from onboard.spots.regions import (
    MOST_REGIONS,
    Part,
    Region,
    about_peak,
    above,
    is_cut_off,
    is_filled,
    peaks,
    region_of,
    size_limits,
)
from onboard.spots.tried_people import Tried, TriedPeople
from onboard.spots.would_find import found_at

Array = NDArray[np.float64]

ZERO_C_K = 273.15
OUT_OF_PICTURE = 25.0  # sigmas of the whole picture, above which a spot may have any size (land in a lake: 20)
TRIED = 4 * LARGEST  # peaks looked at for the tail, of which most are no spots
PARTS = 24, 32  # rows and columns of the grid on which it is known how much ground a pixel shows
LEAST_PX = 2.0  # to a side of what can be distinguished from a pixel's fault


class Detector:
    """Fed with pictures and their sets, in order. What it takes for a spot depends on the ground that it has seen.

    Things are looked for by size, an octave of it at a time, each against the clutter and with the tail of that size:
    ground varies less over half a metre than over five.
    """

    def __init__(self, config: SpotsConfig, scale: ThermalScale | None) -> None:
        self._config, self._scale = config, scale
        smallest = float(np.sqrt(config.smallest_m2))
        octaves = max(int(np.ceil(np.log2(config.largest_m / smallest))), 1)
        self.tails = {smallest * 2.0**k: ClutterTail(config.false_per_km2 / octaves) for k in range(octaves)}
        self._pixel_m = 0.0  # of the newest picture with a scale
        self._people = TriedPeople()
        self.tried = Tried()
        """The outcome in the newest picture of trying people who are put on the ground."""

    @property
    def thresholds(self) -> dict[float, float]:
        """The contrast that a spot of each size (m) must have, in sigmas of the clutter; infinite: not known yet."""
        return {side_m: tail.threshold for side_m, tail in self.tails.items()}

    def look(
        self, counts: NDArray[np.uint16], its_set: FeatureSet, place_m: Array, origin: LocalFrame | None
    ) -> list[Region]:
        """Return the regions of counts (H, W) that stand out, the most significant first.

        `its_set` is the picture's set; `place_m` (2,): about where its ground is, east and north of `origin`, a point
        that stays.
        """
        ground = ground_scale(its_set, PARTS)
        used = ground or usual_scale(its_set.camera, PARTS)
        if ground is not None:
            self._pixel_m = ground.middle_m
        pixel_m = self._pixel_m or USUAL_M / its_set.camera.fx_px
        values = counts.astype(np.float32) if self._scale is None else self._scale.kelvin(counts)
        found = self._large(values, used, pixel_m)
        contrasts = [
            contrast(values, used.is_ground, side_m, pixel_m)
            for side_m in self.tails
            if 2.0 * side_m >= LEAST_PX * pixel_m
        ]
        for c in contrasts:
            tail = self.tails[c.side_m]
            if ground is not None:
                self._learn(c, tail, ground, place_m, pixel_m)
            found += self._regions(c, contrasts[-1], pixel_m, tail.threshold)
        if self._scale is not None:
            self._try_people(values, contrasts, pixel_m, its_set, ground, origin)
        kept = apart(sorted(_wholes_first(found, values), key=lambda region: -region.significance))
        return [region for region in kept if not region.is_part]

    def _regions(self, c: Contrast, largest: Contrast, pixel_m: float, must: float) -> list[Region]:
        """Return the regions of the size of `c` whose contrast is above `must`."""
        reach_px = round(size_limits(largest, pixel_m)[0] * largest.times / c.times)
        found = []
        for size, part, peak in self._small(c, pixel_m, must, MOST_REGIONS):
            region = region_of(c, part, size)
            if region is not None:
                is_part = is_cut_off(c, largest, peak, reach_px)
                found.append(replace(region, significance=size / max(must, 1e-6), is_part=is_part))
        return found

    def _try_people(
        self, values: Image, contrasts: list[Contrast], pixel_m: float, its_set: FeatureSet,
        ground: GroundScale | None, origin: LocalFrame | None,
    ) -> None:  # fmt: skip
        """Put people on the ground of a picture (H, W) in kelvin with its contrasts."""
        if ground is None or origin is None:
            self._people.missed()
            self.tried = Tried()
            return
        find = partial(found_at, values, contrasts, self.thresholds, pixel_m)
        self.tried = self._people.look(GroundView(its_set, ground, origin), its_set.capture_unix_ns, find)

    def _learn(self, c: Contrast, tail: ClutterTail, ground: GroundScale, place_m: Array, pixel_m: float) -> None:
        """Add to `tail` how much of the picture looks like a spot, if its ground has not been counted yet. (25.6)"""
        width, height = c.size_px
        area_km2 = 1e-6 * ground.area_m2((width, height)) * c.times**2
        if area_km2 > 0.0 and tail.ground.is_new(place_m, area_km2):
            found = self._small(c, pixel_m, 0.0, LARGEST)
            tail.add(place_m, area_km2, np.array([size for size, *_ in found]))

    def _small(self, c: Contrast, pixel_m: float, least: float, most: int) -> list[tuple[float, Part, tuple[int, int]]]:
        """Contrasts, parts and peaks of what has the size that `c` is for, the greatest first."""
        reach_px, least_px = size_limits(c, pixel_m)
        found: list[tuple[float, Part, tuple[int, int]]] = []
        for peak in peaks(c, least, TRIED):
            row, column = int(peak[0]), int(peak[1])
            if any(part.holds(row, column) for _, part, _ in found):
                continue
            part = about_peak(c.excess, (row, column), reach_px, least_px)
            if part is not None:
                found.append((float(c.in_clutter[row, column]), part, (row, column)))
                if len(found) == most:
                    break
        return found

    def _large(self, values: Image, ground: GroundScale, pixel_m: float) -> list[Region]:
        """Return regions by heat alone; where temperatures are not known, those far above all of the picture."""
        size, usual = in_picture(values, ground.is_ground)
        if self._scale is None:
            level = size - np.float32(OUT_OF_PICTURE)
        else:
            level = np.where(size != 0.0, values - np.float32(self._config.hotter_than_c + ZERO_C_K), np.float32(-1.0))
        return above(values, usual, size, level, self._config.smallest_m2 / pixel_m**2)


def _wholes_first(regions: list[Region], values: Image) -> list[Region]:
    """Regions of a picture (H, W), of which one that is filled by what is as hot comes before two parts of it or more.

    A large thing's corners stand out of surroundings that it fills itself: by a small thing's size they are several.
    """
    out = []
    for region in regions:
        parts = apart([one for one in regions if one.pixels < region.pixels and _is_in(one.uv_px, region)])
        least = region.significance
        if len(parts) > 1 and is_filled(region, values):
            least = max(least, float(np.nextafter(max(part.significance for part in parts), np.inf)))
        out.append(replace(region, significance=least))
    return out


def apart(regions: list[Region]) -> list[Region]:
    """Without those that lie about the middle of one before them, or have their own middle in it."""
    kept: list[Region] = []
    for region in regions:
        if not any(are_one(region, other) for other in kept):
            kept.append(region)
    return kept[:MOST_REGIONS]


def are_one(region: Region, other: Region) -> bool:
    """Return whether one of two regions lies about the middle of the other."""
    return _is_in(region.uv_px, other) or _is_in(other.uv_px, region)


def _is_in(uv_px: Array, region: Region) -> bool:
    """Return whether a place is within a region's outline, to a pixel of the coarser picture that it was found in."""
    u, v = (float(px) for px in uv_px)
    distance_px = cv2.pointPolygonTest(region.outline_px.astype(np.float32), (u, v), measureDist=True)
    return distance_px >= 1.0 - region.pixels
