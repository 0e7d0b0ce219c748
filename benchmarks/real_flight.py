"""Repeatability on the real flight: the same ground point clicked in every picture that shows it.

    python -m benchmarks.real_flight [--shared ../shared/data/cmac_2018] [--set solve.attitude=none ...]

There is no surveyed truth. SIFT, which the pipeline does not use, finds the same ground points in several pictures;
each is clicked in all of them and the distances from their mean are the figures. `pc-onboard` and `pc-ground` run as a
user runs them: two commands, one recording between them.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.geodesy import LocalFrame
from onboard.vision.contrast_normalisation import prepare

MIN_VIEWS = 3
MAX_POINTS = 200
RATIO = 0.75
HOMOGRAPHY_PX = 6.0

Answer = dict[str, Any]  # one line of `pc-ground click --format json`


def matches(pictures: list[NDArray[np.uint8]]) -> list[dict[int, NDArray[np.float64]]]:
    """Ground points in MIN_VIEWS pictures or more: frame -> pixel (2,), by SIFT with ratio and homography checks."""
    sift = cv2.SIFT_create(3000)  # type: ignore[attr-defined]
    found = [sift.detectAndCompute(prepare(p), None) for p in pictures]
    matcher = cv2.BFMatcher()
    parent: dict[tuple[int, int], tuple[int, int]] = {}

    def root(node: tuple[int, int]) -> tuple[int, int]:
        while parent.setdefault(node, node) != node:
            node = parent[node]
        return node

    for a in range(len(pictures)):
        for b in range(a + 1, min(a + 5, len(pictures))):
            pairs = [m for m, n in matcher.knnMatch(found[a][1], found[b][1], k=2) if m.distance < RATIO * n.distance]
            if len(pairs) < 12:
                continue
            p = np.array([found[a][0][m.queryIdx].pt for m in pairs])
            q = np.array([found[b][0][m.trainIdx].pt for m in pairs])
            _, inliers = cv2.findHomography(p, q, cv2.RANSAC, HOMOGRAPHY_PX)
            if inliers is None or inliers.sum() < 12:
                continue
            for m, good in zip(pairs, inliers[:, 0], strict=True):
                if good:
                    parent[root((a, m.queryIdx))] = root((b, m.trainIdx))
    groups: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for node in parent:
        groups.setdefault(root(node), []).append(node)
    points = []
    for members in groups.values():
        frames = Counter(f for f, _ in members)
        if len(frames) >= MIN_VIEWS and max(frames.values()) == 1:
            points.append({f: np.array(found[f][0][k].pt) for f, k in members})
    rng = np.random.default_rng(0)
    points.sort(key=lambda p: (-len(p), min(p)))
    return [points[i] for i in rng.permutation(len(points))[:MAX_POINTS]]


def run(module: str, *arguments: str) -> str:
    """One of our commands as a user runs it; its standard output."""
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments], capture_output=True, text=True, check=False, timeout=300
    )
    if done.returncode not in (0, 3):
        raise SystemExit(f"{module} {' '.join(arguments)}: exit {done.returncode}\n{done.stderr}")
    return done.stdout + done.stderr


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shared", type=Path, default=Path("../shared/data/cmac_2018"))
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    options = parser.parse_args()
    files = sorted((options.shared / "frames").iterdir())
    pictures = [np.asarray(cv2.imread(str(f), cv2.IMREAD_GRAYSCALE), np.uint8) for f in files]
    camera = Camera.from_json(options.shared / "camera.json")
    points = matches(pictures)
    with tempfile.TemporaryDirectory() as scratch:
        config, recording, clicks = (Path(scratch) / n for n in ("config.toml", "flight.mcap", "clicks.csv"))
        sections: dict[str, list[str]] = {}
        for setting in options.set:
            section, rest = setting.split(".", 1)
            sections.setdefault(section, []).append(rest)
        config.write_text("".join(f"[{s}]\n" + "\n".join(lines) + "\n" for s, lines in sections.items()))
        print(
            run(
                "onboard", "replay", "--config", str(config), "--frames", str(options.shared / "frames"), "--telemetry",
                str(options.shared / "telemetry.tlog"), "--camera", str(options.shared / "camera.json"), "--out",
                str(recording),
            )
        )  # fmt: skip
        rows = [(i, f, *uv) for i, point in enumerate(points) for f, uv in point.items() if camera.contains(uv)]
        with clicks.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["frame", "u", "v"])
            writer.writerows([r[1:] for r in rows])
        answers = [
            json.loads(line)
            for line in run("ground", "click", "--batch", str(clicks), "--from", str(recording)).splitlines()
        ]
    report(rows, answers, len(points), len(files))


def report(rows: list[tuple[int, int, float, float]], answers: list[Answer], points: int, frames: int) -> None:
    """Print the figures."""
    placed: dict[int, list[tuple[int, Answer]]] = {}
    for (point, frame, _, _), answer in zip(rows, answers, strict=True):
        if answer["status"] == "ok":
            placed.setdefault(point, []).append((frame, answer))
    misses, heights, normalised = [], [], []
    by_frame: dict[int, list[float]] = {}
    used = 0
    for views in placed.values():
        if len(views) < MIN_VIEWS:
            continue
        used += 1
        at = LocalFrame(views[0][1]["lat_deg"], views[0][1]["lon_deg"], views[0][1]["height_amsl_m"])
        enu = np.array([at.to_enu(a["lat_deg"], a["lon_deg"], a["height_amsl_m"]) for _, a in views])
        away = enu - enu.mean(axis=0)
        for (frame, answer), miss in zip(views, away, strict=True):
            distance = float(np.hypot(miss[0], miss[1]))
            misses.append(distance)
            heights.append(abs(float(miss[2])))
            by_frame.setdefault(frame, []).append(distance)
            normalised.append(distance / answer["ellipse"]["semi_major_m"])
    refused = Counter(a["status"] for a in answers if a["status"] != "ok")
    radii = [a["ellipse"]["semi_major_m"] for a in answers if a["status"] == "ok"]
    print(f"points chosen by SIFT {points}, clicked in 3 or more pictures {used}, clicks {len(answers)}")
    print(f"refused clicks {dict(refused)}; pictures that answer {len(by_frame)} of {frames}")
    median, most, largest = np.median(misses), np.quantile(misses, 0.9), np.max(misses)
    print(
        f"horizontal distance from the point's mean: median {median:.2f} m, 90 % {most:.2f} m, largest {largest:.2f} m"
    )
    print(f"height about the mean: median {np.median(heights):.2f} m")
    share = np.quantile(normalised, 0.9)
    print(f"stated 90 % semi-major axis: median {np.median(radii):.2f} m; distance over axis: 90 % below {share:.2f}")
    print("median distance by picture: " + "  ".join(f"{f}:{np.median(d):.2f}" for f, d in sorted(by_frame.items())))


if __name__ == "__main__":
    main()
