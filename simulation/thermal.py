"""A thermal camera's view of the synthetic ground: temperatures, warm things, and a microbolometer's own faults.

The ground is that of the visible renderer, its layers as differences of temperature: roads and bare soil in the sun are
warm, hedges and shrubs cool, water is level. Everything is mixed as radiance (the fourth power of temperature), through
the air and the lens, and read as counts: of a radiometric camera, or grey values by its own automatic gain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import InputError
from contract.thermal_scale import ThermalScale
from simulation.heat_sources import Fire, HeatSource, rocks_near
from simulation.renderer import Renderer, RowPoses, SensorSpec, View
from simulation.terrain import Terrain
from simulation.texture import Texture
from simulation.trajectory import Pose

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Counts = NDArray[np.uint16] | NDArray[np.uint8]

LAYERS_K = (6.0, 10.0, 16.0, 20.0)  # kelvin of a unit of brightness, of each layer of land, the finest first
SUN_K = 10.0  # between ground that faces the sun and ground that does not see it
WATER_BELOW = -0.085  # of the broadest layer: 4 % of the ground
SKY_K = 255.0  # that ground with an emissivity below 1 reflects
EMISSIVITY = 0.96
BENEATH_M = 2.0  # over which the ground below a thing has one temperature
PARTS, MOST_PARTS = 12.0, 40  # rays to the narrower side of a warm thing, at least 5; and along a pixel's side at most
REACH_M = 400.0  # to which rocks are looked for


@dataclass(frozen=True)
class ThermalSpec:
    """The scene's heat and the camera's faults. Kelvin, metres, seconds after the first picture.

    `contrast` scales all differences of the ground (1: 2 to 3 K, one sigma). `netd_k` is one sigma of the noise,
    `pattern_k` that of the fixed pattern just after a shutter event, and `drift_k_min` what it grows by in a minute.
    At each of `shutter_s` the picture stands still for `freeze_s`, the pattern is another afterwards, and all counts
    have moved by about `jump_k`. `blur_px` is the lens's, `lag_s` the time over which a pixel gathers warmth.
    `output` "agc": 8 bits, stretched by the camera, no `scale`.
    """

    ground_k: float = 290.0
    contrast: float = 1.0
    air_k: float = 288.0
    air_m: float = 5000.0  # over which the air takes off all but 1/e
    rocks_km2: float = 0.0
    rock_excess_k: float = 2.0
    sources: tuple[HeatSource, ...] = ()
    fires: tuple[Fire, ...] = ()
    netd_k: float = 0.05
    pattern_k: float = 0.05
    drift_k_min: float = 0.1
    blur_px: float = 0.6
    lag_s: float = 0.01
    shutter_s: tuple[float, ...] = ()
    freeze_s: float = 0.4
    jump_k: float = 1.0
    range_k: tuple[float, float] = (233.0, 823.0)
    output: str = "radiometric"
    scale: ThermalScale = field(default_factory=lambda: ThermalScale(0.01))

    def __post_init__(self) -> None:
        if self.output not in ("radiometric", "agc"):
            raise InputError(f"thermal output {self.output!r} is not known; use radiometric or agc")
        faults = (self.netd_k, self.pattern_k, self.drift_k_min, self.blur_px, self.freeze_s, self.jump_k)
        if min(faults) < 0.0 or self.air_m <= 0.0 or not 0.0 <= self.rocks_km2 <= 400.0:
            raise InputError(
                "thermal: faults must not be negative, the air's length be positive, rocks lie in 0..400 a km2"
            )

    @property
    def is_radiometric(self) -> bool:
        """True if counts are temperatures by `scale`."""
        return self.output == "radiometric"

    @property
    def emitters(self) -> tuple[HeatSource | Fire, ...]:
        """The things that are placed: sources and fires."""
        return (*self.sources, *self.fires)


@dataclass(frozen=True, eq=False)
class Seen:
    """The truth of a warm thing at one time: east, north (2,), its area, and temperatures of itself and its ground."""

    source: HeatSource | Fire
    place_m: Array
    area_m2: float
    kelvin: float
    ground_k: float


class ThermalRenderer:
    """Draws what a thermal camera sees. Pictures come in order: while the shutter is closed the last one is repeated.

    `first_s`: when the first picture is taken, on the pictures' clock.
    """

    def __init__(
        self, camera: Camera, terrain: Terrain, texture: Texture, spec: ThermalSpec, seed: int = 0, first_s: float = 0.0
    ) -> None:
        if texture.spec.style != "land":
            raise InputError(f"thermal: the ground's texture is {texture.spec.style}; only land has temperatures")
        self.camera, self.terrain, self.texture, self.spec = camera, terrain, texture, spec
        self.sensor = SensorSpec(0.0, 0.0, 1.0, spec.lag_s)
        self._rays = Renderer(camera, terrain, texture, self.sensor, seed)
        self._seed, self._first_s = seed, first_s
        self._last: Counts | None = None

    def picture(
        self, poses: list[Pose], gain: float, frame: int, time_s: float = 0.0, rows: list[RowPoses] | None = None
    ) -> Counts:
        """One picture (H, W) as the camera gives it, uint16 or uint8; `gain` is a visible camera's, and not used."""
        after_s = time_s - self._first_s
        if self._last is not None and any(0.0 <= after_s - begin < self.spec.freeze_s for begin in self.spec.shutter_s):
            return self._last
        radiance = self.radiance(poses[0], time_s, rows[0] if rows else None)
        for i, pose in enumerate(poses[1:], start=1):
            radiance = radiance + self.radiance(pose, time_s, rows[i] if rows else None)
        kelvin = self._through_the_lens(radiance / np.float32(len(poses))) + self._pattern_k(after_s)
        rng = np.random.default_rng([self._seed, 303, frame])
        kelvin += np.float32(self.spec.netd_k) * rng.standard_normal(kelvin.shape, dtype=np.float32)
        self._last = self._read(kelvin)
        return self._last

    def radiance(self, pose: Pose, time_s: float = 0.0, rows: RowPoses | None = None) -> Image:
        """Temperature (H, W) to the fourth power, K^4 / 1e8, that reaches an ideal sensor at one instant."""
        v = self._rays.view(pose, rows)
        total = (self.ground_k(pose.centre_m[:2], v.east_m, v.north_m, v.footprint_m, v.shade) / 100.0) ** 4
        after_s = time_s - self._first_s
        for source in self._in_view(pose, v, after_s):
            self._paint(total, source, pose, v, after_s)
        clear = np.exp(-v.distance_m * np.float32(1.0 / self.spec.air_m)) * v.is_seen
        out: Image = total * clear + np.float32((self.spec.air_k / 100.0) ** 4) * (np.float32(1.0) - clear)
        return out

    def ground_k(
        self, origin_m: Array, x_m: Image, y_m: Image, footprint_m: Image, shade: Image | float = 1.0
    ) -> Image:
        """Apparent temperature (H, W) of bare ground at `origin_m` (2,) + (`x_m`, `y_m`) seen at that footprint."""
        layers = []
        for layer in self.texture.layers:
            layers.append(np.zeros(x_m.shape, np.float32))
            layer.tile.add_to(layers[-1], origin_m, x_m, y_m, footprint_m)
        warmth = sum(np.float32(k) * layer for k, layer in zip(LAYERS_K, layers, strict=True))
        warmth += np.float32(SUN_K) * (np.asarray(shade, np.float32) - np.float32(1.0))
        water = np.clip((np.float32(WATER_BELOW) - layers[3]) * np.float32(100.0), 0.0, 1.0)
        warmth = warmth * (np.float32(1.0) - water) - np.float32(4.0) * water
        kinetic = np.float32(self.spec.ground_k) + np.float32(self.spec.contrast) * warmth
        # Bare and stony ground (bright) emits less than what grows or is wet.
        emissivity = np.clip(np.float32(EMISSIVITY) - np.float32(0.08) * layers[2] + np.float32(0.02) * water, 0.9, 1.0)
        out: Image = (emissivity * kinetic**4 + (np.float32(1.0) - emissivity) * np.float32(SKY_K**4)) ** 0.25
        return np.asarray(out, np.float32)

    def sources_near(self, place_m: Array) -> list[HeatSource | Fire]:
        """Everything that is warm and may be seen from above a place (2,): what is placed, and rocks."""
        s = self.spec
        rocks = rocks_near(place_m, REACH_M, s.rocks_km2, s.rock_excess_k, self._seed) if s.rocks_km2 else []
        return [*rocks, *s.emitters]

    def _in_view(self, pose: Pose, v: View, after_s: float) -> list[HeatSource | Fire]:
        """The sources that lie within the rectangle, east and north, that the picture shows, or reach into it."""
        if not v.is_seen.any():
            return []
        ground = np.stack([v.east_m[v.is_seen], v.north_m[v.is_seen]], axis=-1)
        low, high = pose.centre_m[:2] + ground.min(axis=0), pose.centre_m[:2] + ground.max(axis=0)

        def is_near(source: HeatSource | Fire) -> bool:
            place, reach = source.place_m(after_s), source.reach_m(after_s) + BENEATH_M
            return bool(np.all(place > low - reach) and np.all(place < high + reach))

        return [source for source in self.sources_near(pose.centre_m[:2]) if is_near(source)]

    def seen(self, source: HeatSource | Fire, time_s: float) -> Seen:
        """A thing's truth, `time_s` after the first picture."""
        place, ground = source.place_m(time_s), self._beneath_k(source, time_s)
        return Seen(source, place, source.area_m2(time_s), source.hottest_k(ground, time_s), ground)

    def _beneath_k(self, source: HeatSource | Fire, time_s: float) -> float:
        place, zero = source.place_m(time_s), np.zeros((1, 1), np.float32)
        slope = self.terrain.slope(place[0], place[1])
        shade = Renderer.sunlit(slope.reshape(1, 2))
        return float(self.ground_k(place, zero, zero, zero + np.float32(BENEATH_M), float(shade[0]))[0, 0])

    def _paint(self, total: Image, source: HeatSource | Fire, pose: Pose, v: View, after_s: float) -> None:
        """A warm thing into radiance (H, W): each pixel by the share that it covers, however small or slanted."""
        place, reach = source.place_m(after_s), source.reach_m(after_s)
        offset = place - pose.centre_m[:2]
        margin = np.float32(reach) + np.float32(2.0) * v.footprint_m
        near = (np.abs(v.east_m - np.float32(offset[0])) < margin) & (
            np.abs(v.north_m - np.float32(offset[1])) < margin
        )
        near &= v.is_seen
        rows, columns = np.nonzero(near)
        if not len(rows):
            return
        # Rays of each pixel's parts meet the level through the point that its own ray meets.
        finest_m = float(v.footprint_m[rows, columns].min())
        count = int(np.clip(np.ceil(PARTS * finest_m / source.narrow_m), 5, MOST_PARTS))
        part = (np.arange(count) + 0.5) / count - 0.5
        du, dv = (axis.ravel() for axis in np.meshgrid(part, part))
        uv = np.stack([columns[:, None] + du, rows[:, None] + dv], axis=-1)
        rays = self.camera.unproject(uv)[0] @ pose.R_enu_cam.T
        own = self.camera.unproject(np.stack([columns, rows], axis=-1).astype(float))[0] @ pose.R_enu_cam.T
        depth = own[:, None, 2] * v.depth_m[rows, columns][:, None] / np.minimum(rays[..., 2], -1e-6)
        ground = np.stack([v.east_m[rows, columns], v.north_m[rows, columns]], axis=-1)[:, None] + (
            rays[..., :2] * depth[..., None] - (own[:, :2] * v.depth_m[rows, columns][:, None])[:, None]
        )
        warm = source.warmth_k(
            ground[..., 0] - offset[0], ground[..., 1] - offset[1], self._beneath_k(source, after_s), after_s
        )
        share = np.isfinite(warm).mean(axis=1)
        radiance = np.where(np.isfinite(warm), (np.nan_to_num(warm) / 100.0) ** 4, 0.0).mean(axis=1)
        total[rows, columns] = total[rows, columns] * (1.0 - share) + radiance

    def _through_the_lens(self, radiance: Image) -> Image:
        if self.spec.blur_px > 0.0:
            radiance = np.asarray(cv2.GaussianBlur(radiance, (0, 0), self.spec.blur_px), np.float32)
        return np.asarray(np.float32(100.0) * radiance**0.25, np.float32)

    def _pattern_k(self, after_s: float) -> Image:
        """The sensor's own pattern, K (H, W): pixels, columns and shading, fixed from one shutter event to the next."""
        past = [s for s in self.spec.shutter_s if s <= after_s]
        begun_s = max(past, default=0.0)
        fixed, drift = (_pattern(self.camera.size_px, [self._seed, kind, len(past)]) for kind in (909, 910))
        grown_k = self.spec.drift_k_min * max(after_s - begun_s, 0.0) / 60.0
        jump_k = self.spec.jump_k * np.random.default_rng([self._seed, 912, len(past)]).standard_normal()
        return np.asarray(self.spec.pattern_k * fixed + grown_k * drift + (jump_k if past else 0.0), np.float32)

    def _read(self, kelvin: Image) -> Counts:
        if self.spec.is_radiometric:
            return self.spec.scale.counts(np.clip(kelvin, *self.spec.range_k))
        low, high = np.percentile(kelvin, [1.0, 99.0])
        grey: NDArray[np.uint8] = np.clip((kelvin - low) * (255.0 / max(high - low, 1.0)), 0, 255).astype(np.uint8)
        return grey


def _pattern(size_px: tuple[int, int], seed: list[int]) -> Image:
    """A fixed pattern (H, W) of unit variance: half of it single pixels, a quarter columns, a quarter shading."""
    width, height = size_px
    rng = np.random.default_rng(seed)
    pixels = rng.standard_normal((height, width), dtype=np.float32)
    columns = rng.standard_normal(width, dtype=np.float32)
    small = cv2.resize(rng.standard_normal((4, 5)).astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
    shading = (small - small.mean()) / max(float(small.std()), 1e-6)
    return np.asarray(np.sqrt(0.5) * pixels + 0.5 * columns + 0.5 * shading, np.float32)
