"""`pc-onboard calibrate --from SESSION.mcap`: a better camera file, from what a flight found of the camera."""

from __future__ import annotations

import argparse
import json
import threading
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from contract.camera import SIGMA_KEYS, UNKNOWN_SIGMA, Camera
from contract.errors import InputError
from contract.whole_file import save
from onboard.commands.replay import recorded_flight
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import replay

FOUND = 0.7  # of a sigma, at most, that a flight must leave for its estimate to be worth a file


def run(arguments: argparse.Namespace) -> int:
    """Replay the session and write the camera that was estimated; 0: written, 1: the flight determines it too poorly.

    A camera that is taken as it is (its file states sigmas of nothing) is taken for a lens known by its type.
    """
    cv2.setNumThreads(1)
    if arguments.out is None:
        raise InputError("calibrate: name the camera file to write: --out CAMERA.json")
    if not arguments.out.parent.is_dir():
        raise InputError(f"{arguments.out}: no such folder as {arguments.out.parent}")
    config, filed, flight = recorded_flight(arguments.from_session)
    if filed.zoom is not None:
        raise InputError(
            "calibrate: the camera file has a zoom table, and a flight shows one lens only: use --pictures"
        )
    if not any(filed.sigma):
        filed = replace(filed, stated_sigma=UNKNOWN_SIGMA)
    pipeline = Pipeline(config, filed)
    summary = replay(flight, pipeline, [], None, 0.0, None, threading.Event())
    camera, sigma = pipeline.window.camera_found()
    ratio = np.array(sigma) / np.maximum(filed.sigma, 1e-12)
    print(f"pictures solved     {summary.solved} of {summary.frames}")
    for name, was, now, own, before in zip(
        SIGMA_KEYS, _numbers(filed), _numbers(camera), sigma, filed.sigma, strict=True
    ):
        print(f"{name:<20}{was:.6g} -> {now:.6g}, one sigma {own:.2g} (before: {before:.2g})")
    if not pipeline.window.alignment.updates or np.all(ratio > FOUND):
        print(f"{arguments.out} is not written: this flight shows too little of its camera; turns and climbs show most")
        return 1
    _write(arguments.out, replace(camera, stated_sigma=sigma), arguments.from_session)
    print(f"written: {arguments.out}")
    return 0


def _numbers(camera: Camera) -> tuple[float, ...]:
    return camera.fx_px, camera.cx_px, camera.cy_px, camera.distortion[0], camera.distortion[1]


def _write(path: Path, camera: Camera, source: Path) -> None:
    known = json.loads(camera.to_json())
    known["calibration"]["from_flight"] = source.name
    save(path, json.dumps(known, indent=1) + "\n")
