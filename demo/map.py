"""The flight seen from above: features, clicked positions with their ellipses, and what is true."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from demo.clicks import Clicked, Spot
from demo.tracks import Sample, mark_features, show_picture
from ground.recording import Recording
from simulation.texture import Texture, TextureSpec
from simulation.truth import Truth

Array = NDArray[np.float64]

mpl.use("Agg")
PIN, TRUE, PATH = "#ffd60a", "#00e5ff", "#ffffff"
MARGIN_M = 25.0
OUTLINE = (patheffects.withStroke(linewidth=2.5, foreground="black"),)


def draw_overview(
    truth: Truth,
    ground: TextureSpec,
    recording: Recording,
    samples: Sequence[Sample],
    spots: Sequence[Spot],
    clicked: Sequence[Clicked],
    out: Path,
) -> list[Path]:
    """`map.png` (everything, and each spot close up) and `overview.jpg` (a picture next to the map); the files."""
    (vehicle,) = recording.vehicles
    sets = [s for f in recording.frames(vehicle) if (s := recording.by_frame(vehicle, f)) is not None and s.is_ok]
    texture = Texture(ground)

    figure = Figure(figsize=(14.0, 8.0), dpi=110, layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=(0.72, 1.15))
    left, right = figure.add_subfigure(grid[0, 0]), figure.add_subfigure(grid[0, 1])
    _draw_map(left.subplots(), truth, texture, sets, spots, clicked)
    right.suptitle("Each spot close up: what was clicked, its 90 % ellipse, what is true", fontsize=11)
    for axes, spot in zip(right.subplots(2, 2).flat, spots, strict=True):
        _draw_spot(axes, texture, spot, [c for c in clicked if c.spot is spot])
    map_file = out / "map.png"
    figure.savefig(map_file)

    figure = Figure(figsize=(11.0, 5.2), dpi=90, layout="constrained")
    grid = figure.add_gridspec(1, 2, width_ratios=(1.65, 1.0))
    _draw_clicks(figure.add_subfigure(grid[0, 0]).subplots(), samples, clicked)
    _draw_map(figure.add_subfigure(grid[0, 1]).subplots(), truth, texture, sets, spots, clicked)
    overview_file = out / "overview.jpg"
    figure.savefig(overview_file, pil_kwargs={"quality": 82})
    return [map_file, overview_file]


def feature_positions(feature_set: FeatureSet, origin: LocalFrame, undulation_m: float) -> Array:
    """Features (N, 3) of a set in ENU metres about a session's origin: C + R (x, y, 1) / w."""
    s = feature_set
    rays, valid = s.camera.unproject(s.uv_px)
    offsets = (rays / s.inverse_depth_per_m[:, None])[valid] @ s.R_enu_cam.T
    camera = LocalFrame(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m + undulation_m)
    lat, lon, height = camera.to_geodetic(offsets).T
    return origin.to_enu(lat, lon, height)


def _draw_map(
    axes: Axes,
    truth: Truth,
    texture: Texture,
    sets: Sequence[FeatureSet],
    spots: Sequence[Spot],
    clicked: Sequence[Clicked],
) -> None:
    keyframes = [s for s in sets if s.is_keyframe]
    features = np.concatenate([feature_positions(s, truth.origin, truth.undulation_m) for s in keyframes[::3]])
    cameras = np.array([truth.origin.to_enu(s.camera_lat_deg, s.camera_lon_deg, truth.origin.height_m) for s in sets])
    everything = np.concatenate([features[:, :2], cameras[:, :2]])
    low, high = everything.min(axis=0) - MARGIN_M, everything.max(axis=0) + MARGIN_M
    _draw_ground(axes, texture, low, high)
    height_m = features[:, 2] + truth.origin.height_m - truth.undulation_m
    dots = axes.scatter(features[:, 0], features[:, 1], c=height_m, s=13, cmap="turbo", ec="black", linewidths=0.3)
    figure = axes.figure
    figure.colorbar(dots, ax=axes, label="height of a feature, m above mean sea level", shrink=0.7)
    axes.plot(*cameras[:, :2].T, color=PATH, lw=1.6, path_effects=OUTLINE)
    axes.annotate(
        "", _place(cameras[-1]), _place(cameras[-2]), arrowprops={"arrowstyle": "-|>", "color": PATH, "lw": 2.0}
    )
    _draw_pins(axes, clicked)
    for spot in spots:
        axes.plot(*spot.enu_m[:2], "x", color=TRUE, ms=7, mew=2.0, path_effects=OUTLINE)
        axes.annotate(
            spot.name, _place(spot.enu_m), (8, 7), textcoords="offset points",
            color="white", fontsize=12, weight="bold", path_effects=OUTLINE,
        )  # fmt: skip
    axes.legend(
        handles=[
            Line2D([], [], color="#7a7a7a", lw=2.0, label="flight"),
            Line2D([], [], ls="", marker="o", color="#30a060", mec="black", mew=0.3, ms=5, label="features"),
            Line2D([], [], ls="", marker="o", mfc=PIN, mec="black", ms=6, label="clicked, 90 % ellipse"),
            Line2D([], [], ls="", marker="x", color="#00a5b8", mew=2, ms=7, label="true"),
        ],
        loc="upper center",
        bbox_to_anchor=(0.5, -0.08),
        ncols=2,
        fontsize=8,
        frameon=False,
    )
    axes.set_title("From above", fontsize=11)


def _draw_spot(axes: Axes, texture: Texture, spot: Spot, clicked: Sequence[Clicked]) -> None:
    answered = [c for c in clicked if c.enu_m is not None]
    reach = max([1.25 * c.answer["ellipse"]["semi_major_m"] + (c.error_m or 0.0) for c in answered] or [10.0])
    _draw_ground(axes, texture, spot.enu_m[:2] - reach, spot.enu_m[:2] + reach)
    _draw_pins(axes, answered)
    axes.plot(*spot.enu_m[:2], "x", color=TRUE, ms=10, mew=2.5, path_effects=OUTLINE)
    for place, c in enumerate(answered):
        assert c.enu_m is not None
        axes.annotate(
            f"frame {c.view.frame}: {c.error_m:.1f} m off", _place(c.enu_m), (10, (-16, 10)[place % 2]),
            textcoords="offset points", color=PIN, fontsize=9, path_effects=OUTLINE,
        )  # fmt: skip
    refused = [f"frame {c.view.frame}: {c.answer['status']}" for c in clicked if c.enu_m is None]
    axes.set_title("   ".join([f"spot {spot.name}", *refused]), fontsize=10)


def _draw_clicks(axes: Axes, samples: Sequence[Sample], clicked: Sequence[Clicked]) -> None:
    """The picture with the most clicks on it, its features and the clicked pixels."""
    frames = [c.view.frame for c in clicked]
    frame = max(frames, key=frames.count)
    sample = min(samples, key=lambda s: abs(s.frame - frame))
    show_picture(axes, sample.image)
    mark_features(axes, sample)
    for c in clicked:
        if c.view.frame == sample.frame:
            axes.plot(c.view.u_px, c.view.v_px, "+", color=PIN, ms=16, mew=2.5, path_effects=OUTLINE)
            axes.annotate(
                f"click {c.spot.name}", (c.view.u_px, c.view.v_px), (10, 8), textcoords="offset points",
                color=PIN, fontsize=12, weight="bold", path_effects=OUTLINE,
            )  # fmt: skip
    axes.set_title(f"Frame {sample.frame}: features (red) and clicks", fontsize=11)


def _draw_ground(axes: Axes, texture: Texture, low: Array, high: Array) -> None:
    """The simulated world's own brightness as the map's background, east to the right, north up."""
    size = high - low
    step_m = float(size.max()) / 900.0
    east, north = np.meshgrid(np.arange(0.0, size[0], step_m), np.arange(0.0, size[1], step_m))
    footprint = np.full(east.shape, step_m, np.float32)
    albedo = texture.albedo(low, east.astype(np.float32), north.astype(np.float32), footprint)
    axes.imshow(
        np.sqrt(albedo), cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=(low[0], high[0], low[1], high[1])
    )
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_xlabel("east, m", fontsize=9)
    axes.set_ylabel("north, m", fontsize=9)
    axes.tick_params(labelsize=8)


def _place(enu_m: Array) -> tuple[float, float]:
    """East and north."""
    return float(enu_m[0]), float(enu_m[1])


def _draw_pins(axes: Axes, clicked: Sequence[Clicked]) -> None:
    for c in clicked:
        if c.enu_m is None:
            continue
        e = c.answer["ellipse"]
        # Azimuth is clockwise from north, matplotlib's angle counter-clockwise from east.
        axes_m = 2.0 * e["semi_major_m"], 2.0 * e["semi_minor_m"]
        axes.add_patch(Ellipse(_place(c.enu_m), *axes_m, angle=90.0 - e["azimuth_deg"], fill=False, ec=PIN, lw=1.5))
        axes.plot(*c.enu_m[:2], "o", mfc=PIN, mec="black", mew=0.8, ms=6)
