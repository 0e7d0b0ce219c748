"""`pc-onboard camera`: reads a camera file, ours or another tool's, prints what it took and left, and writes ours."""

from __future__ import annotations

import argparse

import numpy as np

from contract.lens import FISHEYE
from contract.whole_file import save
from onboard.camera_files.formats import CameraFile, read_camera_file


def run(arguments: argparse.Namespace) -> int:
    """Print what is in the file; write it as ours with --out. Raises InputError for what cannot be read or written."""
    read = read_camera_file(arguments.file, arguments.size, arguments.which)
    print("\n".join(text(read)))
    if arguments.out is not None:
        save(arguments.out, read.camera.to_json() + "\n")
        print(f"written: {arguments.out}")
    return 0


def text(read: CameraFile) -> list[str]:
    """Return lines for people: the format, what it took and left, the lens, its sigmas."""
    camera = read.camera
    lines = [f"format: {'our own' if read.form is None else read.form.name}"]
    if read.took:
        lines.append(f"took: {', '.join(read.took)}")
    if read.left:
        lines.append(f"left: {', '.join(_shown(name) for name in read.left[:20])}")
    if read.had:
        lines.append(f"reduced: without {' and '.join(read.had)} its pixels are up to {read.off_px:.2g} px off")
    lens = "fisheye" if camera.model == FISHEYE else "lens"
    lines += [
        f"{lens}: {camera.width_px}x{camera.height_px}, {camera.hfov_deg:.1f} deg wide without its distortion; "
        f"fx {camera.fx_px:.2f} fy {camera.fy_px:.2f} cx {camera.cx_px:.2f} cy {camera.cy_px:.2f} px",
        "distortion: " + " ".join(f"{n} {v:.6g}" for n, v in zip(camera.lens.names, camera.distortion, strict=True)),
        _sigma_line(read),
    ]
    axes = (np.linspace(0.0, n - 1.0, 17) for n in camera.size_px)
    rayless = 1.0 - float(np.mean(camera.unproject(np.stack(np.meshgrid(*axes), axis=-1))[1]))
    if rayless > 0.0:
        why = "where the distortion folds" + (" or beyond 80 degrees off the axis" if camera.model == FISHEYE else "")
        lines.append(f"no ray: {100.0 * rayless:.0f} % of the picture, {why}; left out in flight")
    return lines


def _shown(name: str) -> str:
    """A file's own word, short and without what a terminal would obey."""
    return "".join(c for c in name[:40] if c.isprintable())


def _sigma_line(read: CameraFile) -> str:
    f, x, y, k1, k2 = read.camera.sigma
    centre = x * read.camera.focal_px, y * read.camera.focal_px
    stated = f"focal length {100.0 * f:.2g} %, centre {centre[0]:.2g} {centre[1]:.2g} px, k1 {k1:.2g}, k2 {k2:.2g}"
    return f"sigmas: {stated}" + ("" if read.has_sigmas else "; the file states none: a lens known by its type")
