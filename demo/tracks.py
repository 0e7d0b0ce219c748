"""Pictures of tracking, as the seed draws it: sample frames, features (red followed, green new), their paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.config.schema import load_config
from onboard.events.types import Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

mpl.use("Agg")
RED, GREEN = "#ff3b30", "#35d04f"
APART = 10  # pictures between the samples, at least


@dataclass(frozen=True, eq=False)
class Sample:
    """One picture's features: pixels (N, 2) of those followed here and of those new here, and paths since detection."""

    frame: int
    image: Picture
    followed_px: Array
    new_px: Array
    paths_px: list[Array]
    is_keyframe: bool


@dataclass(eq=False)
class _Paths:
    """The pixels of each feature, picture by picture."""

    by_id: dict[int, list[Array]] = field(default_factory=dict)

    def note(self, ids: NDArray[np.int64], uv_px: Array) -> None:
        for key, uv in zip(ids.tolist(), uv_px, strict=True):
            self.by_id.setdefault(key, []).append(uv)


def follow(flight: Path) -> list[Sample]:
    """Drive the pipeline over a simulated flight and look over its tracker's shoulder."""
    config = load_config(flight / "config.toml")
    camera = Camera.from_json(flight / "camera.json")
    source = Flight.open(config, camera, flight / "frames", flight / "telemetry.tlog", flight / "stamps.csv")
    pipeline = Pipeline(config, camera)
    images: dict[int, Picture] = {}
    paths = _Paths()
    samples: list[Sample] = []
    newest = -1
    for _, event in source.events():
        if isinstance(event, Frame) and event.image is not None:
            images[event.index] = event.image
        for out in pipeline.handle(event):
            if out.frame <= newest:
                continue  # an earlier picture, placed again
            newest = out.frame
            tracks = pipeline.tracks or pipeline.tracker.nothing()
            new_ids, new_px = np.zeros(0, np.int64), np.zeros((0, 2))
            if out.is_keyframe:
                ids, uv = pipeline.tracker.keyframe_features
                is_new = ~np.isin(ids, tracks.ids)
                new_ids, new_px = ids[is_new], uv[is_new]
            paths.note(tracks.ids, tracks.uv_px)
            paths.note(new_ids, new_px)
            lines = [np.array(paths.by_id[key]) for key in tracks.ids.tolist()]
            samples.append(Sample(newest, images.pop(newest), tracks.uv_px, new_px, lines, out.is_keyframe))
    return samples


def draw_tracks(samples: Sequence[Sample], out: Path) -> list[Path]:
    """The seed's figures 1 to 3 from three keyframes; returns the files."""
    chosen = _three(samples)
    names = ("1_frames", "2_features", "3_paths")
    captions = (
        f"Sample frames, {chosen[1].frame - chosen[0].frame} apart",
        "Features: red, seen before and found again; green, new to replace those that left",
        "Paths: red circle, where a feature is now; red line, its way since it was first detected",
    )
    files = []
    for kind, (name, caption) in enumerate(zip(names, captions, strict=True)):
        height, width = chosen[0].image.shape
        figure = Figure(figsize=(15.0, 5.0 * height / width + 0.75), dpi=110, layout="constrained")
        figure.suptitle(caption, fontsize=13)
        for axes, sample in zip(figure.subplots(1, len(chosen)), chosen, strict=True):
            show_picture(axes, sample.image)
            axes.set_title(f"frame {sample.frame}", fontsize=11)
            if kind == 1:
                mark_features(axes, sample)
                axes.set_xlabel(f"{len(sample.followed_px)} followed, {len(sample.new_px)} new", fontsize=10)
            elif kind == 2:
                axes.add_collection(LineCollection(sample.paths_px, colors=RED, linewidths=1.0))
                axes.plot(*sample.followed_px.T, "o", ms=5, mfc="none", mec=RED, mew=1.2)
        files.append(out / f"tracks_{name}.png")
        figure.savefig(files[-1])
    return files


def show_picture(axes: Axes, image: Picture) -> None:
    """A grey picture in pixel axes, without numbers."""
    height, width = image.shape
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xticks=[], yticks=[])


def mark_features(axes: Axes, sample: Sample) -> list[Line2D]:
    """Followed features red, new ones green; returns handles for a legend."""
    red = axes.plot(*sample.followed_px.T, "o", ms=5, mfc="none", mec=RED, mew=1.3, label="followed")
    green = axes.plot(*sample.new_px.T, "o", ms=5, mfc="none", mec=GREEN, mew=1.3, label="new")
    return [*red, *green]


def _three(samples: Sequence[Sample]) -> list[Sample]:
    """Three keyframes at least APART pictures from one another, where the flight has them; else the last pictures."""
    keyframes = [s for s in samples if s.is_keyframe and len(s.followed_px)] or list(samples)
    chosen = [keyframes[len(keyframes) // 4]]
    for sample in keyframes:
        if len(chosen) < 3 and sample.frame >= chosen[-1].frame + APART:
            chosen.append(sample)
    return chosen if len(chosen) == 3 else list(samples[-3:])
