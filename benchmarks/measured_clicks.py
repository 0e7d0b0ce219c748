"""Clicked pixels measured by themselves, against what the features around them give, on simulated flights with truth.

    python -m benchmarks.measured_clicks [--scenes down-town,ahead-town,...] [--clicks 400] [--seed 0]

Each flight is 10 s at 200 m above a world with edges (simulation/raster.py), 640x480 and 60 degrees wide, four pictures
a second; the whole pipeline makes the sets. Clicked are pixels of pictures in the middle of the flight, in their last
sets, with all pictures kept: on roofs and trees, on ground within 6 m of them, and on open ground. Errors are without
what all answers of a picture share: along the true ray, less the three modes of inverse depth that the set's own
features show against the truth (9.4), those on one even surface: of one at an edge the truth at its pixel may be the
other surface's. `inside`: share within 1.645 of the stated own sigma (90 %), `> 3`: beyond three;
how well the features show those modes is added to it.

A scene is `LOOK-GROUND`, or `LOOK-GROUND-FAULT`: `lost` 30 % of the pictures, `h264` at 2 Mbit/s (of 30 pictures a
second; needs GStreamer), `rolling` rows that are read in 30 ms.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from benchmarks.machine import describe, load, table, verdict
from benchmarks.source_codecs import recoded

# isort: split
import cv2
import numpy as np
from numpy.typing import NDArray

from contract.answer import Fix
from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.locate import Locator
from onboard.config.schema import load_config
from onboard.events.kept_pictures import Grey, KeptPictures
from onboard.events.types import Frame
from onboard.measured.question import Questions
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from simulation.truth import Truth

Array = NDArray[np.float64]

DEFAULT = (
    "down-town,ahead-town,ahead-forest,down-none,down-stripes,ahead-stripes,"
    "down-town-lost,ahead-town-lost,down-town-h264,ahead-town-h264,down-none-rolling"
)
LOST_SHARE, KBIT, READOUT_S = 0.3, 2000.0, 0.03
RATE_HZ, SECONDS, HEIGHT_M, SPEED_M_S = 4.0, 10.0, 200.0, 15.0
PITCH_DEG = {"down": -90.0, "ahead": -45.0}
PICTURES = 6  # that are clicked
NEAR_M = 6.0
KINDS = ("roofs, trees", "ground near them", "open ground")
HALF_PX = 7.0  # of the window that a feature is found by
SHARE_GOAL, MS_GOAL = 0.85, 15.0


@dataclass(frozen=True)
class Scored:
    """One click: errors (3,) east, north, up of both answers, one sigma of the latter's height, or why not."""

    kind: str
    frame: int
    interpolated_m: Array
    measured_m: Array | None
    sigma_m: float
    why: str
    ms: float


@dataclass
class Scene:
    """A kind of flight and what became of its clicks."""

    name: str
    clicks: list[Scored] = field(default_factory=list)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=DEFAULT)
    parser.add_argument("--clicks", type=int, default=300, help="of each scene")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    rows: list[tuple[str, ...]] = []
    for name in args.scenes.split(","):
        scene = measure(name, args.clicks, args.seed)
        for kind in KINDS:
            rows += row(scene, kind)
        why = [c.why for c in scene.clicks if c.why]
        counts = ", ".join(f"{word} {why.count(word)}" for word in sorted(set(why)))
        ms = float(np.median([c.ms for c in scene.clicks]))
        print(
            f"{name}: {len(scene.clicks)} clicks, {ms:.1f} ms each ({verdict(ms <= MS_GOAL)}); not: {counts or '-'}",
            flush=True,
        )
    head = ("", "clicks", "measured", "up med / 90 %", "interpolated", "horizontal", "interpolated", "inside", "> 3")
    print("\n" + table(head, rows))
    return 0


def spec_of(name: str, seed: int) -> SessionSpec:
    """A scene by its name: where the camera looks, and over what."""
    look, ground, *fault = name.split("-")
    kind = ground if ground in ("town", "forest") else "none"
    return SessionSpec(
        DescribedSpec(PathSpec("straight", speed_m_s=SPEED_M_S, height_m=HEIGHT_M), seed=seed),
        seconds=SECONDS,
        rate_hz=RATE_HZ,
        camera=Camera.from_field_of_view(640, 480, 60.0),
        mount_deg=(0.0, PITCH_DEG[look], 0.0),
        terrain=TerrainSpec(relief_m=5.0, obstacles=kind, obstacle_height_m=14.0, obstacle_cell_m=32.0, seed=seed),
        texture=TextureSpec("stripes" if ground == "stripes" else "land", seed=seed),
        readout_s=READOUT_S if fault == ["rolling"] else 0.0,
        seed=seed,
    )


def measure(name: str, clicks: int, seed: int) -> Scene:
    """Draw the flight, fly it, and click on it."""
    with tempfile.TemporaryDirectory() as folder:
        flight = Path(folder) / "flight"
        truth = fly(spec_of(name, seed), flight)
        pictures, sets = kept(flight, came(flight, name, seed))
    return Scene(name, list(clicked(truth, pictures, sets, clicks, seed)))


def came(flight: Path, name: str, seed: int) -> dict[int, Grey]:
    """The pictures of a flight's folder by number, as a scene's fault has left them."""
    paths = sorted((flight / "frames").iterdir())
    images = {
        number: np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8) for number, path in enumerate(paths)
    }
    fault = name.split("-")[2:]
    if fault == ["lost"]:
        lost = np.random.default_rng([seed, 6]).uniform(size=len(images)) < LOST_SHARE
        return {number: image for number, image in images.items() if not lost[number]}
    if fault == ["h264"]:
        (raw := flight / "pictures.raw").write_bytes(b"".join(image.tobytes() for image in images.values()))
        size_px = images[0].shape[1], images[0].shape[0]
        return recoded(raw, size_px, len(images), RATE_HZ, codec="H264", kbit=KBIT, loss=0.0).images
    return images


def kept(flight: Path, images: dict[int, Grey]) -> tuple[KeptPictures, dict[int, FeatureSet]]:
    """These pictures of a flight's folder that have sets, and their last sets."""
    config, camera = load_config(flight / "config.toml"), Camera.from_json(flight / "camera.json")
    recorded = Flight.open(config, camera, flight / "frames", flight / "telemetry.tlog", flight / "stamps.csv")
    pipeline = Pipeline(config, recorded.camera)
    sets: dict[int, FeatureSet] = {}
    for _, event in recorded.events():
        if not isinstance(event, Frame):
            made = pipeline.handle(event)
        elif (image := images.get(event.index)) is not None:
            made = pipeline.handle(replace(event, image=image))
        else:
            continue
        sets |= {s.frame: s for s in made if s.is_ok}
    sets |= {s.frame: s for s in pipeline.finish() if s.is_ok}
    pictures = KeptPictures(1_000_000_000)
    for frame in sorted(sets):
        pictures.add(images[frame], sets[frame])
    return pictures, sets


def clicked(
    truth: Truth, pictures: KeptPictures, sets: dict[int, FeatureSet], count: int, seed: int
) -> Iterator[Scored]:
    """Clicks evenly over the pictures in the middle: as many of each kind as there are."""
    rng, questions = np.random.default_rng([seed, 5]), Questions()
    frames = sorted(sets)[len(sets) // 4 : -len(sets) // 4]
    for frame in [frames[i] for i in np.linspace(0, len(frames) - 1, PICTURES).astype(int)]:
        s = sets[frame]
        uv = rng.uniform(10.0, np.subtract(s.camera.size_px, 11.0), (count // PICTURES, 2)).round(1)
        kinds, depth_m = kinds_of(truth, frame, uv)
        rays, _ = s.camera.unproject(uv)
        shared, shared_cov = shared_of(truth, frame, s)
        locator = Locator(s)
        for kind, ray, true_m, pixel in zip(kinds, rays, depth_m, uv, strict=True):
            began_s = time.thread_time()
            answer = questions.measured_set(
                s, (float(pixel[0]), float(pixel[1])), *pictures.placed(s.session, frame)
            ).clicked
            ms = 1e3 * (time.thread_time() - began_s)
            plain = locator.locate(pixel)
            assert answer is not None
            if not isinstance(plain, Fix):
                continue
            w_plain = 1.0 / float((s.R_enu_cam.T @ plain.offset_enu_m)[2])
            along = truth.poses[frame].R_enu_cam @ ray * true_m
            h = np.array([1.0, *ray[:2]])
            off, off_sigma = float(h @ shared), float(np.sqrt(h @ shared_cov @ h))
            # Of a relative error e of inverse depth the place moves by -e along its ray.
            theirs = -along * (w_plain * true_m - 1.0 - off)
            if not answer.is_measured:
                yield Scored(kind, frame, theirs, None, 0.0, answer.measured.value, ms)
                continue
            ours = -along * (answer.inverse_depth_per_m * true_m - 1.0 - off)
            sigma_m = abs(along[2]) * float(np.hypot(answer.sigma_per_m / answer.inverse_depth_per_m, off_sigma))
            yield Scored(kind, frame, theirs, ours, sigma_m, "", ms)


def shared_of(truth: Truth, frame: int, s: FeatureSet) -> tuple[Array, Array]:
    """The modes (3,) of relative inverse depth by which a set's features are off together, weighted as they state their
    errors, and the modes' own covariance (3, 3) by what is left.

    Only features on an even surface count, and of these not what lies three sigmas off the others: a corner of a roof
    is tracked as it is, but the truth at its pixel may be the ground's next to it.
    """
    depth_m = depths(truth, frame, s.uv_px)
    off = s.inverse_depth_per_m * depth_m - 1.0
    sigma = s.sigma_inverse_depth_per_m / s.inverse_depth_per_m
    H = np.column_stack([np.ones(len(s)), s.camera.unproject(s.uv_px)[0][:, :2]])
    modes: Array = np.zeros(3)
    even = unevenness(truth, frame, s.uv_px) < sigma
    used, spread = even, 1.0
    for _ in range(10):
        whitened = H[used] / sigma[used, None]
        modes = np.asarray(np.linalg.lstsq(whitened, off[used] / sigma[used], rcond=None)[0], float)
        left = np.abs(off - H @ modes) / sigma
        spread = max(1.0, 1.483 * float(np.median(left[even])))
        used = even & (left < 3.0 * spread)
    whitened = H[used] / (spread * sigma[used, None])
    return modes, np.asarray(np.linalg.inv(whitened.T @ whitened), float)


def unevenness(truth: Truth, frame: int, uv: Array) -> Array:
    """The share by which the inverse depth about pixels (N, 2) is off a plane at most (N,); infinite where the
    window that a feature is found by reaches beyond the ground.
    """
    steps = np.linspace(-HALF_PX, HALF_PX, 7)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    depth_m = depths(truth, frame, (uv[:, None] + offsets).reshape(-1, 2)).reshape(len(uv), -1)
    whole = np.asarray(np.isfinite(depth_m).all(axis=1), bool)
    w = np.where(whole[:, None], 1.0 / np.where(np.isfinite(depth_m), depth_m, 1.0), 1.0)
    plane = np.column_stack([np.ones(len(offsets)), offsets])
    off = w - w @ np.linalg.pinv(plane).T @ plane.T
    return np.where(whole, np.abs(off).max(axis=1) / w.mean(axis=1), np.inf)


def depths(truth: Truth, frame: int, uv: Array) -> Array:
    """True depths (N,) along the camera's axis of pixels (N, 2), m; NaN where there is no ground ahead."""
    points, pose = truth.ground(frame, uv), truth.poses[frame]
    depth_m = ((points.enu_m - pose.centre_m) @ pose.R_enu_cam)[:, 2]
    return np.where(points.is_valid & (depth_m > 0.0), depth_m, np.nan)


def kinds_of(truth: Truth, frame: int, uv: Array) -> tuple[list[str], Array]:
    """Return the kind of surface that pixels (N, 2) show, and its true depth (N,) along the camera's axis, m."""
    enu_m = truth.ground(frame, uv).enu_m
    lift = truth.terrain.obstacle_m(enu_m[:, 0], enu_m[:, 1])
    angles = np.arange(8) * np.pi / 4.0
    near = [
        truth.terrain.obstacle_m(enu_m[:, 0] + r * np.cos(a), enu_m[:, 1] + r * np.sin(a))
        for a in angles
        for r in (0.5 * NEAR_M, NEAR_M)
    ]
    is_near = np.max(near, axis=0) > 0.5
    kinds = [KINDS[0] if up > 0.5 else KINDS[1] if close else KINDS[2] for up, close in zip(lift, is_near, strict=True)]
    pose = truth.poses[frame]
    return kinds, ((enu_m - pose.centre_m) @ pose.R_enu_cam)[:, 2]


def row(scene: Scene, kind: str) -> list[tuple[str, ...]]:
    """A line of the table; none where there are no such clicks."""
    clicks = [c for c in scene.clicks if c.kind == kind]
    measured = [c for c in clicks if c.measured_m is not None]
    if len(measured) < 5:
        return []
    ours = np.array([c.measured_m for c in measured])
    theirs = np.array([c.interpolated_m for c in measured])
    z = np.abs(ours[:, 2]) / np.array([c.sigma_m for c in measured])
    share = len(measured) / len(clicks)

    def two(values: Array) -> str:
        return "{:.2f} / {:.2f} m".format(*np.quantile(values, [0.5, 0.9]))

    return [(
        f"{scene.name}: {kind}", str(len(clicks)), f"{share:.0%}", two(np.abs(ours[:, 2])), two(np.abs(theirs[:, 2])),
        two(np.hypot(ours[:, 0], ours[:, 1])), two(np.hypot(theirs[:, 0], theirs[:, 1])),
        f"{np.mean(z < 1.645):.1%}", f"{np.mean(z > 3.0):.1%}",
    )]  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
