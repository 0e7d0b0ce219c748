"""`pc-onboard calibrate`: a camera file from pictures of a board, out of a folder or live from the camera."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import queue
import sys
import time
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from PIL import Image

from contract.camera import Camera
from contract.errors import ConfigError, InputError
from contract.supervised_thread import Policy, SupervisedThread
from contract.whole_file import save
from onboard.calibration.board import Board, Grey
from onboard.calibration.intrinsics import Fit, View, calibrate
from onboard.calibration.verdict import Verdict, bare_places, coverage_picture, judge, report
from onboard.camera.factory import open_device
from onboard.camera.picture_files import PICTURE_SUFFIXES, read_grey
from onboard.camera.pixel_formats import UNDECODABLE
from onboard.config.schema import CameraConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import State
from onboard.events.types import Frame

PRINT_DPI = 300
MARGIN_M = 0.008
STILL_SHARE = 1.0 / 800.0
"""The share of the picture's width below which the corners' motion from one picture to the next shows a still board."""
STILL_WITHIN_S = 0.5
NEW_SHARE = 0.03
"""The share of the picture's width by which corners must be away from those of every view kept."""


def run(arguments: argparse.Namespace) -> int:
    """Print a board, or calibrate; 0: good and written, 1: not good, nothing written unless `--accept`."""
    board = board_of(arguments)
    if arguments.print_board is not None:
        print_board(board, arguments.print_board)
        if arguments.pictures is None and arguments.device is None:
            return 0
    if (arguments.pictures is None) == (arguments.device is None):
        raise ConfigError(
            "calibrate: name either --pictures FOLDER or --device /dev/videoN, or --from SESSION.mcap (see --help)"
        )
    if arguments.out is None:
        raise ConfigError("calibrate: name the camera file to write: --out CAMERA.json")
    check_writable(arguments.out)
    if arguments.pictures is not None:
        views, size_px = views_of_folder(board, arguments.pictures)
    else:
        if arguments.size is None:
            raise ConfigError(
                "calibrate: --device needs the picture size, such as --size 1280x720 (`pc-onboard cameras`)"
            )
        views, size_px = views_of_device(board, arguments), arguments.size
    return conclude(views, size_px, arguments.out, arguments.coverage, arguments.accept)


def board_of(arguments: argparse.Namespace) -> Board:
    """The board that the arguments describe."""
    columns, rows = arguments.squares
    return Board(
        arguments.board,
        columns,
        rows,
        arguments.square_mm / 1000.0,
        (arguments.marker_mm or 0.74 * arguments.square_mm) / 1000.0,
        arguments.dictionary,
    )


def conclude(views: list[View], size_px: tuple[int, int], out: Path, coverage: Path | None, accept: bool) -> int:
    """Fit, report, draw, and write if it is good."""
    result = calibrate(views, size_px)
    fit, dropped = (None, []) if result is None else result
    verdict = judge(fit, dropped, size_px, len(views))
    if fit is not None:
        print(report(fit, dropped))
        picture = coverage or out.with_suffix(".coverage.png")
        save(picture, cv2.imencode(".png", coverage_picture(fit, verdict))[1].tobytes())
        print(f"coverage: {picture}")
    print(f"verdict: {verdict}")
    if fit is None or not (verdict.is_good or accept):
        print(f"{out} is not written" + ("" if fit is None else " (--accept writes it all the same)"))
        return 1
    save(out, camera_file(fit, verdict))
    print(f"written: {out}")
    return 0 if verdict.is_good else 1


def camera_file(fit: Fit, verdict: Verdict) -> str:
    """The camera file: what `Camera.from_json` reads, and in addition how good it is."""
    known = json.loads(fit.camera.to_json())
    known["calibration"] = {
        "verdict": str(verdict),
        "views": len(fit.views),
        "reprojection_rms_px": round(fit.rms_px, 4),
        "distortion_model": fit.model.name,
        "worst_direction_sigma_px": round(float(fit.ray_sigma_px.max()), 4),
        "sigma": {name: float(f"{fit.sigmas[name]:.3g}") for name in fit.model.parameters},
    }
    return json.dumps(known, indent=1) + "\n"


def check_writable(path: Path) -> None:
    """Before half an hour of holding boards."""
    folder = path.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK) or path.is_dir():
        raise InputError(f"{path}: cannot be written there")


def print_board(board: Board, path: Path) -> None:
    """A picture of the board at its true size, PNG or PDF."""
    if path.suffix.lower() not in {".png", ".pdf"}:
        raise InputError(f"{path}: a board is printed from .png or .pdf")
    square_px = round(board.square_m / 0.0254 * PRINT_DPI)
    margin_px = round(MARGIN_M / 0.0254 * PRINT_DPI)
    page = np.pad(board.picture(square_px), margin_px, constant_values=255)
    exact_mm = square_px / PRINT_DPI * 25.4
    marker = f", markers {board.marker_m * 1000:g} mm, {board.dictionary}" if board.kind == "charuco" else ""
    squares = f"{board.kind} {board.columns}x{board.rows}, squares {board.square_m * 1000:g} mm"
    caption = f"{squares}{marker}: print at 100 %, measure"
    cv2.putText(page, caption, (margin_px, page.shape[0] - 30), cv2.FONT_HERSHEY_SIMPLEX, 0.9, 0, 2, cv2.LINE_AA)
    size_mm = [n / PRINT_DPI * 25.4 for n in page.shape[::-1]]
    try:
        if path.suffix.lower() == ".png":
            Image.fromarray(page).save(path, dpi=(PRINT_DPI, PRINT_DPI))
        else:
            Image.fromarray(page).save(path, "PDF", resolution=PRINT_DPI)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
    print(
        f"{path}: {size_mm[0]:.0f} x {size_mm[1]:.0f} mm at {PRINT_DPI} dpi, squares {exact_mm:.2f} mm. "
        "Print at 100 %, glue it to something flat, measure a square and give that as --square-mm"
    )


def views_of_folder(board: Board, folder: Path) -> tuple[list[View], tuple[int, int]]:
    """Every view of the board in a folder's pictures, and their size. Raises InputError without any picture."""
    if not folder.is_dir():
        raise InputError(f"pictures {folder}: no such folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES)
    if not paths:
        raise InputError(f"pictures {folder}: no picture in it")
    views, size_px, without = [], None, []
    for path in paths:
        try:
            picture = read_grey(path)
        except UNDECODABLE as error:
            raise InputError(f"pictures {folder}: {path.name} cannot be decoded") from error
        size_px = size_px or (picture.shape[1], picture.shape[0])
        if (picture.shape[1], picture.shape[0]) != size_px:
            raise InputError(
                f"pictures {folder}: {path.name} is {picture.shape[1]}x{picture.shape[0]}, "
                f"the ones before {size_px[0]}x{size_px[1]}"
            )
        view = board.find(picture, path.name)
        if view is None:
            without.append(path.name)
        else:
            views.append(view)
    assert size_px is not None
    print(
        f"board found in {len(views)} of {len(paths)} pictures" + (f", not in {', '.join(without)}" if without else "")
    )
    return views, size_px


class Collector:
    """Keeps views that are still, and new."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.kept: list[View] = []
        self._width_px = size_px[0]
        self._last: tuple[int, View] | None = None

    def offer(self, stamp_ns: int, view: View | None) -> bool:
        """Take a view, seen at a time; returns whether it was kept."""
        last, self._last = self._last, None if view is None else (stamp_ns, view)
        if view is None or last is None or stamp_ns - last[0] > STILL_WITHIN_S * 1e9:
            return False
        moved_px = _distance_px(view, last[1])
        is_still = moved_px is not None and moved_px < STILL_SHARE * self._width_px
        apart = [_distance_px(view, kept) for kept in self.kept]
        is_new = all(px is None or px > NEW_SHARE * self._width_px for px in apart)
        if is_still and is_new:
            self.kept.append(view)
        return is_still and is_new


def _distance_px(a: View, b: View) -> float | None:
    """Return the mean distance between the corners that two views share; None if they share too few."""
    _, in_a, in_b = np.intersect1d(a.numbers, b.numbers, return_indices=True)
    if len(in_a) < 4:
        return None
    return float(np.mean(np.linalg.norm(a.uv_px[in_a] - b.uv_px[in_b], axis=1)))


class Live:
    """The camera in a thread of its own, and its newest picture."""

    def __init__(self, device: str, size_px: tuple[int, int], format_: str) -> None:
        self.camera = open_device(
            CameraConfig.model_validate({"device": device, "format": format_}),
            Camera.from_field_of_view(*size_px, 60.0),
            SessionClock.start(),
        )
        self._newest: queue.Queue[Frame] = queue.Queue(1)
        # Without its pictures there is nothing to calibrate: what ends it ends the command.
        self._thread = SupervisedThread(
            "camera", lambda stop: self.camera.run(self._emit, stop), Policy.END, late_after_s=None
        )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.end()
        self._thread.join()

    def _emit(self, _: int, event: object) -> None:
        if isinstance(event, Frame) and event.image is not None:
            with contextlib.suppress(queue.Empty):
                self._newest.get_nowait()
            self._newest.put(event)

    def picture(self) -> Frame | None:
        """The newest picture not had yet; None if none came in half a second. Raises whatever ended the camera."""
        try:
            return self._newest.get(timeout=0.5)
        except queue.Empty:
            if self._thread.has_failed:
                raise self._thread.error or InputError("the camera has ended; start again") from None
            return None


def views_of_device(board: Board, arguments: argparse.Namespace) -> list[View]:
    """Watch the camera until there are views enough, the time is up, or Ctrl-C ends the collecting."""
    collector = Collector(arguments.size)
    ends = time.monotonic() + arguments.seconds
    print(f"show the board to {arguments.device}: all over the picture, leaning all ways, still for a moment each time")
    reported = ""
    with contextlib.suppress(KeyboardInterrupt), Live(arguments.device, arguments.size, arguments.format) as live:
        while len(collector.kept) < arguments.views and time.monotonic() < ends:
            frame = live.picture()
            health = live.camera.health()
            if health.state in {State.LOST, State.FROZEN} and health.state.value != reported:
                print(f"camera {health.state.value}: {health.detail}", file=sys.stderr)
            reported = health.state.value
            if frame is None or frame.image is None:
                continue
            if collector.offer(frame.stamp_ns, board.find(frame.image, f"view {len(collector.kept) + 1}")):
                _kept(collector.kept, frame.image, arguments)
    return collector.kept


def _kept(kept: list[View], image: Grey, arguments: argparse.Namespace) -> None:
    """Report that, and what is still missing."""
    bare = bare_places(kept, arguments.size)
    print(f"{len(kept)}/{arguments.views}" + (f"; nothing yet at {', '.join(bare[:3])}" if bare else ""), flush=True)
    if arguments.keep is not None:
        try:
            arguments.keep.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(arguments.keep / f"view_{len(kept):03d}.png")
        except OSError as error:
            raise InputError(f"{arguments.keep}: {error.strerror or error}") from error
