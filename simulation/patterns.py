"""The periodic pictures the ground is made of, drawn by this code: differences of brightness, float32, square."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SIZE = 2048
COUNTRY_SIZE = 1024


def periodic_noise(rng: np.random.Generator, size: int, shortest: float, longest: float, slope: float) -> Image:
    """Noise of unit variance with wavelengths `shortest` to `longest` texels; amplitude ~ wavelength**slope."""
    spectrum = scipy.fft.rfft2(rng.standard_normal((size, size), dtype=np.float32))
    spectrum *= _gain(size, shortest, longest, slope)
    noise: Image = scipy.fft.irfft2(spectrum, s=(size, size)).astype(np.float32, copy=False)
    noise /= np.float32(noise.std())
    return noise


@lru_cache(maxsize=2)
def _gain(size: int, shortest: float, longest: float, slope: float) -> Image:
    """Amplitude of each frequency of `periodic_noise`, (size, size / 2 + 1). Grain asks for the same two by turns."""
    fy = np.fft.fftfreq(size).astype(np.float32)[:, None]
    fx = np.fft.rfftfreq(size).astype(np.float32)[None, :]
    frequency = np.hypot(fx, fy)
    frequency[0, 0] = 1.0
    gain: Image = frequency ** np.float32(-slope - 1.0)
    gain *= np.exp(-((frequency * np.float32(shortest / 1.5)) ** 4)) * (1.0 - np.exp(-((frequency * longest) ** 2)))
    gain[0, 0] = 0.0
    return gain


def draw_grain(rng: np.random.Generator) -> Image:
    """Grass, stones and soil: strong from 3 texels to a few hundred."""
    noise = periodic_noise(rng, SIZE, 3.0, 250.0, -0.1)
    where = periodic_noise(rng, SIZE, 60.0, 600.0, 0.5)
    # Tussocks: real ground has more dark specks than bright ones, and corners to lock on to.
    specks = np.maximum(noise - np.float32(1.0), np.float32(0.0)) * np.clip(where + np.float32(1.0), 0.2, 2.0)
    return np.asarray(np.float32(0.042) * noise - np.float32(0.07) * specks, np.float32)


def _periodic_regions(rng: np.random.Generator, size: int, count: int) -> NDArray[np.int32]:
    """Labels (size, size) of a Voronoi partition of the torus into `count` regions, with irregular borders."""
    pad = size // 2
    sites = rng.integers(0, size, (count, 2))
    marks = np.full((size, size), 255, np.uint8)
    marks[sites[:, 1], sites[:, 0]] = 0
    number = np.zeros((size, size), np.int32)
    number[sites[:, 1], sites[:, 0]] = np.arange(count)
    wrapped = np.pad(marks, pad, mode="wrap")
    _, label = cv2.distanceTransformWithLabels(wrapped, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    names = np.zeros(int(label.max()) + 1, np.int32)
    rows, columns = np.nonzero(wrapped == 0)
    names[label[rows, columns]] = number[(rows - pad) % size, (columns - pad) % size]
    regions: NDArray[np.int32] = names[label[pad : pad + size, pad : pad + size]]
    bend_x = periodic_noise(rng, size, 60.0, 600.0, 1.2) * 5.0 + np.arange(size, dtype=np.float32)[None, :]
    bend_y = periodic_noise(rng, size, 60.0, 600.0, 1.2) * 5.0 + np.arange(size, dtype=np.float32)[:, None]
    x, y = np.rint(bend_x).astype(np.int64) % size, np.rint(bend_y).astype(np.int64) % size
    bent: NDArray[np.int32] = regions[y, x]
    return bent


def _stamp(canvas: Image, x: float, y: float, radius: float, value: float, crown: Image) -> None:
    """A ragged disc, lit from one side, added to a periodic picture; `crown` is noise that frays its edge."""
    size, reach = canvas.shape[0], int(np.ceil(radius * 1.8)) + 1
    cx, cy = int(np.floor(x)), int(np.floor(y))
    offset = np.arange(-reach, reach + 1)
    dx, dy = offset[None, :] + cx - x, offset[:, None] + cy - y
    where = np.ix_((cy + offset) % size, (cx + offset) % size)
    edge = radius * (1.0 + 0.22 * crown[where])
    cover = np.clip((edge - np.hypot(dx, dy)) / 1.5 + 0.5, 0.0, 1.0)
    lit = 1.0 - 0.35 * (dx + dy) / max(radius, 1.0) * np.sign(-value)
    canvas[where] += (cover * value * np.clip(lit, 0.4, 1.6)).astype(np.float32)


def _road(rng: np.random.Generator, size: int, along_x: bool, width: float) -> Image:
    """Coverage (size, size), 0 to 1, of a winding track that meets itself at the picture's edges."""
    s = np.arange(size) * (2.0 * np.pi / size)
    wiggle = np.full(size, rng.uniform(0.0, size))
    for harmonic in range(1, 5):
        wiggle += rng.normal(0.0, 0.045 * size / harmonic**1.6) * np.sin(harmonic * s + rng.uniform(0.0, 2.0 * np.pi))
    slope = np.gradient(wiggle)
    across = (np.arange(size)[:, None] - wiggle[None, :] + 0.5 * size) % size - 0.5 * size
    distance = np.abs(across) / np.sqrt(1.0 + slope**2)[None, :]
    cover = np.clip(0.5 * width - distance + 0.5, 0.0, 1.0).astype(np.float32)
    return np.ascontiguousarray(cover if along_x else cover.T)


def draw_land(rng: np.random.Generator) -> Image:
    """Fields with plough lines, hedges, tracks and shrubs."""
    regions = _periodic_regions(rng, SIZE, 34)
    count = int(regions.max()) + 1
    tone = rng.uniform(-0.15, 0.14, count).astype(np.float32)
    angle = rng.uniform(0.0, np.pi, count)
    pitch = rng.uniform(7.0, 16.0, count)
    plough = (rng.uniform(size=count) < 0.4).astype(np.float32) * rng.uniform(0.012, 0.03, count).astype(np.float32)
    canvas = tone[regions]
    grid = np.arange(SIZE, dtype=np.float32)
    kx, ky = (
        (2.0 * np.pi / pitch * np.cos(angle)).astype(np.float32),
        (2.0 * np.pi / pitch * np.sin(angle)).astype(np.float32),
    )
    phase = periodic_noise(rng, SIZE, 40.0, 400.0, 1.0)
    canvas += plough[regions] * np.sin(kx[regions] * grid[None, :] + ky[regions] * grid[:, None] + phase)
    canvas += np.float32(0.035) * periodic_noise(rng, SIZE, 8.0, 400.0, 0.5)

    border = (regions != np.roll(regions, 1, 0)) | (regions != np.roll(regions, 1, 1))
    rows, columns = np.nonzero(border)
    crown = periodic_noise(rng, SIZE, 4.0, 60.0, 0.5)
    # Some borders have a dense hedge, others a few bushes.
    dense = rng.uniform(size=count) < 0.4
    hedge = rng.uniform(size=len(rows)) < np.where(dense[regions[rows, columns]], 0.16, 0.02)
    plants = [(x + rng.normal(0.0, 1.5), y + rng.normal(0.0, 1.5), rng.uniform(2.0, 6.0), -rng.uniform(0.08, 0.18))
              for x, y in zip(columns[hedge], rows[hedge], strict=True)]  # fmt: skip
    clumps = rng.uniform(0.0, SIZE, (160, 2))
    for _ in range(1500):
        x, y = (
            rng.uniform(0.0, SIZE, 2)
            if rng.uniform() < 0.4
            else clumps[rng.integers(len(clumps))] + rng.normal(0, 30, 2)
        )
        shade = -rng.uniform(0.08, 0.2) if rng.uniform() < 0.85 else rng.uniform(0.08, 0.25)
        plants.append((float(x), float(y), float(np.exp(rng.normal(1.1, 0.5))), float(shade)))
    for x, y, radius, _ in plants:
        _stamp(canvas, x + 0.7 * radius, y + 0.7 * radius, radius, -0.06, crown)  # its shadow
    for x, y, radius, shade in plants:
        _stamp(canvas, x, y, radius, shade, crown)
    for along_x, width, brightness in ((True, 11.0, 0.24), (False, 7.0, 0.18), (True, 5.0, 0.14), (False, 5.0, -0.08)):
        cover = _road(rng, SIZE, along_x, width)
        rut = brightness + 0.03 * phase
        canvas = canvas * (1.0 - cover) + cover * rut
    return np.asarray(np.clip(canvas, -0.33, 0.5), np.float32)


def draw_country(rng: np.random.Generator) -> Image:
    """Broad patches of light and dark ground."""
    return np.asarray(np.float32(0.05) * periodic_noise(rng, COUNTRY_SIZE, 12.0, 500.0, 1.0), np.float32)


def draw_waves(rng: np.random.Generator) -> Image:
    """Wind waves: a narrow band of wavelengths, sharp crests."""
    noise = periodic_noise(rng, COUNTRY_SIZE, 5.0, 40.0, 0.4)
    crests = np.maximum(noise - np.float32(1.6), np.float32(0.0))
    return np.asarray(np.float32(0.03) * noise + np.float32(0.06) * crests, np.float32)


def draw_wave_train(rng: np.random.Generator, wavelength: float) -> Image:
    """Waves of one length (texels, within a third of an octave) that run along the picture's x axis, crests ragged."""
    spectrum = scipy.fft.rfft2(rng.standard_normal((COUNTRY_SIZE, COUNTRY_SIZE), dtype=np.float32))
    fy = np.fft.fftfreq(COUNTRY_SIZE).astype(np.float32)[:, None]
    fx = np.fft.rfftfreq(COUNTRY_SIZE).astype(np.float32)[None, :]
    frequency = np.maximum(np.hypot(fx, fy), np.float32(1e-6))
    octaves, across = np.log2(frequency * np.float32(wavelength)), np.arctan2(fy, fx)
    gain = np.exp(-0.5 * (octaves / np.float32(0.15)) ** 2 - 0.5 * (across / np.float32(0.3)) ** 2)
    train: Image = scipy.fft.irfft2(spectrum * gain, s=(COUNTRY_SIZE, COUNTRY_SIZE)).astype(np.float32)
    return np.asarray(train / np.float32(train.std()), np.float32)


def draw_stripes() -> Image:
    """Crop rows crossed by wider rows, the same everywhere: every corner has an exact twin 8 m away."""
    s = np.arange(512, dtype=np.float32) * np.float32(2.0 * np.pi / 64.0)
    rows = np.where(np.sin(s) > 0, 0.12, -0.12).astype(np.float32)
    canvas = np.tile(rows, (512, 1)) + np.float32(0.6) * np.tile(rows, (512, 1)).T
    wrapped = cv2.GaussianBlur(np.pad(canvas, 16, mode="wrap"), (0, 0), 2.0)
    return np.asarray(wrapped[16:-16, 16:-16], np.float32)


def draw_vehicles(rng: np.random.Generator, spacing: int) -> tuple[Image, Image]:
    """Vehicles in lanes along the picture's x axis: where they are (1, else 0) and their brightness there, square.

    Each stands alone in a cell of a grid, `spacing` texels long; at 0.25 m a texel they are 10 to 16 m long, and with
    one in 64 m cover a twentieth of the ground.
    """
    where, paint = (
        np.zeros((COUNTRY_SIZE, COUNTRY_SIZE), np.float32),
        np.zeros((COUNTRY_SIZE, COUNTRY_SIZE), np.float32),
    )
    for top in range(0, COUNTRY_SIZE, 64):
        for left in range(0, COUNTRY_SIZE, spacing):
            length, width = int(rng.integers(40, 64)), int(rng.integers(14, 20))
            y, x = top + int(rng.integers(0, 64 - width)), left + int(rng.integers(0, spacing - length))
            body = (slice(y, y + width), slice(x, x + length))
            where[body] = 1.0
            paint[body] = rng.choice([0.08, 0.75, 0.9])
            # A cab and a load, so that a vehicle has corners within.
            paint[y : y + width, x + length - 14 : x + length - 8] = 0.05
            paint[y + 3 : y + width - 3, x + 6 : x + 6 + length // 3] = rng.uniform(0.2, 0.95)
    return where, paint
