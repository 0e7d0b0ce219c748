"""`pc-onboard calibrate --zoom POSITION=DIR ...`: a camera file with a zoom table, from a board at several zooms."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from contract.camera import Camera
from contract.errors import ConfigError
from contract.stated_values import number_or_nan
from contract.whole_file import save
from contract.zoom_table import Unit, ZoomTable
from onboard.calibration.intrinsics import calibrate
from onboard.calibration.verdict import judge, report
from onboard.commands.calibrate import board_of, camera_file, check_writable, views_of_folder


def zoom_positions(texts: list[str]) -> list[tuple[float, Path]]:
    """`POSITION=DIR` texts by rising position. Raises ConfigError for what is none, and for fewer than two."""
    found: dict[float, Path] = {}
    for text in texts:
        position, equals, folder = text.partition("=")
        at = number_or_nan(position)
        if not equals or not folder or not np.isfinite(at) or at in found:
            raise ConfigError(f"calibrate: --zoom {text}: it is POSITION=DIR, each position once, as --zoom 1=wide")
        found[at] = Path(folder)
    if len(found) < 2:
        raise ConfigError("calibrate: a zoom table needs two zoom positions or more: --zoom 1=DIR --zoom 6=DIR")
    return sorted(found.items())


def run(arguments: argparse.Namespace) -> int:
    """Fit each position by itself, and write all of them as one file; 0: good and written, 1: not good.

    The file's own optics and verdict are those of the widest position, its sigmas the largest of any.
    """
    if arguments.pictures is not None or arguments.device is not None:
        raise ConfigError("calibrate: --zoom names the folders itself, without --pictures and --device")
    if arguments.out is None:
        raise ConfigError("calibrate: name the camera file to write: --out CAMERA.json")
    board, out, unit, fits = board_of(arguments), arguments.out, arguments.zoom_unit, []
    positions = zoom_positions(arguments.zoom)
    check_writable(out)
    for position, folder in positions:
        print(f"zoom {position:g}, {folder}")
        views, size_px = views_of_folder(board, folder)
        result = calibrate(views, size_px)
        fit, dropped = (None, []) if result is None else result
        verdict = judge(fit, dropped, size_px, len(views))
        if fit is not None:
            print(report(fit, dropped))
        print(f"verdict: {verdict}")
        if fit is None or not (verdict.is_good or arguments.accept):
            print(f"{out} is not written: the calibration at zoom {position:g} is not good")
            return 1
        fits.append((position, fit, verdict))
    cameras = [fit.camera for _, fit, _ in fits]
    if len({camera.size_px for camera in cameras}) > 1:
        raise ConfigError("calibrate: the pictures of all zoom positions must have the same size")
    if len({camera.model for camera in cameras}) > 1:
        models = ", ".join(f"{position:g} a {fit.camera.model}" for position, fit, _ in fits)
        raise ConfigError(f"calibrate: a zoom table is of one lens model, and at zoom {models} fits best")
    known = json.loads(camera_file(fits[0][1], fits[0][2]))
    known["zoom"] = _table(unit, [position for position, _, _ in fits], cameras, out).to_json()
    widest = cameras[0]
    for key in known["calibration"]["sigma"]:
        # A focal length's counts as a share of it; the others' are pixels, and of the distortion a number.
        shares = [widest.focal_px / camera.focal_px if key in ("fx", "fy") else 1.0 for camera in cameras]
        worst = max(fit.sigmas[key] * share for (_, fit, _), share in zip(fits, shares, strict=True))
        known["calibration"]["sigma"][key] = float(f"{worst:.3g}")
    save(out, json.dumps(known, indent=1) + "\n")
    print(f"written: {out}, zoom {fits[0][0]:g} to {fits[-1][0]:g} {unit}")
    return 0 if all(verdict.is_good for _, _, verdict in fits) else 1


def _table(unit: Unit, positions: list[float], cameras: list[Camera], out: Path) -> ZoomTable:
    raw = {
        "unit": unit,
        "position": positions,
        "focal_px": [camera.focal_px for camera in cameras],
        "cx_px": [camera.cx_px for camera in cameras],
        "cy_px": [camera.cy_px for camera in cameras],
        "k1": [camera.distortion[0] for camera in cameras],
    }
    return ZoomTable.from_json(raw, str(out))
