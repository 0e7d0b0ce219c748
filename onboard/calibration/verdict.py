"""The verdict on a calibration, in words: fit for flight, or what to do; and its picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.calibration.intrinsics import Fit, View, rayless_share

CELLS = (6, 4)
LEAST_VIEWS = 8
LEAST_COVERED = 0.75  # of the cells
FOCAL_SIGMA = 0.003
"""One sigma of the focal length as a share: 0.3 % is 0.3 m in 100 m of height."""
LEAST_TILT_DEG = 12.0
LEAST_TILTED = 3
"""Boards that lean, about each axis of the picture."""
HIGH_ERROR = 1.0 / 800.0
"""Reprojection error as a share of the picture's width: 0.8 px at 640."""
RAY_SIGMA_SHARE = 1.0 / 640.0
MOST_RAYLESS = 0.05
"""The largest share of the picture without rays: corners beyond the fold are left out in flight, they are not wrong."""
_THIRDS = (("upper left", "top", "upper right"), ("left", "middle", "right"), ("lower left", "bottom", "lower right"))


@dataclass(frozen=True)
class Verdict:
    """Good, or what is wrong with what to do next, the gravest first."""

    complaints: tuple[str, ...]

    @property
    def is_good(self) -> bool:
        return not self.complaints

    def __str__(self) -> str:
        return "good" if self.is_good else "not good: " + "; ".join(self.complaints)


def covered_cells(views: list[View] | tuple[View, ...], size_px: tuple[int, int]) -> NDArray[np.intp]:
    """Corners seen in each cell of the picture, (4, 6)."""
    counts = np.zeros((CELLS[1], CELLS[0]), np.intp)
    for view in views:
        u = np.clip(view.uv_px[:, 0] / size_px[0] * CELLS[0], 0, CELLS[0] - 1).astype(int)
        v = np.clip(view.uv_px[:, 1] / size_px[1] * CELLS[1], 0, CELLS[1] - 1).astype(int)
        np.add.at(counts, (v, u), 1)
    return counts


def bare_places(views: list[View] | tuple[View, ...], size_px: tuple[int, int]) -> list[str]:
    """Parts of the picture, in words, where hardly a corner was seen."""
    empty = covered_cells(views, size_px) == 0
    places: dict[str, int] = {}
    for row, column in np.argwhere(empty):
        name = _THIRDS[row * 3 // CELLS[1]][column * 3 // CELLS[0]]
        places[name] = places.get(name, 0) + 1
    return sorted(places, key=lambda name: -places[name])


def lacking_tilts(fit: Fit) -> list[str]:
    """The ways in which boards should lean more: 'forwards or backwards', 'to the left or right'."""
    tilted = np.sum(np.abs(fit.tilts_deg()) >= LEAST_TILT_DEG, axis=0)
    return [way for way, count in zip(("forwards or backwards", "to the left or right"), tilted, strict=True)
            if count < LEAST_TILTED]  # fmt: skip


def judge(fit: Fit | None, dropped: list[View], size_px: tuple[int, int], found: int) -> Verdict:
    """The verdict on a fit; None: nothing could be fitted to the `found` views."""
    if fit is None:
        why = (
            "no camera explains the views" if found >= LEAST_VIEWS else f"the board was found in {found} pictures only"
        )
        return Verdict((f"{why}: take {LEAST_VIEWS * 2} sharp ones of the whole picture, the board tilted",))
    complaints = []
    width = size_px[0]
    used = len(fit.views)
    if used < LEAST_VIEWS:
        complaints.append(f"too few views ({used}): take at least {LEAST_VIEWS}, better {LEAST_VIEWS * 2}")
    focal_share = max(fit.sigmas["fx"] / fit.camera.fx_px, fit.sigmas["fy"] / fit.camera.fy_px)
    if tilts := lacking_tilts(fit):
        extent = "cannot be distinguished from the distance" if focal_share > FOCAL_SIGMA else "is uncertain"
        complaints.append(
            f"too few tilts: the focal length {extent} (one sigma {focal_share:.2%}) "
            f"while boards face the camera: lean the board 20 to 40 degrees {' and '.join(tilts)}"
        )
    elif focal_share > FOCAL_SIGMA:
        complaints.append(
            f"focal length known to {focal_share:.2%} only (one sigma, {FOCAL_SIGMA:.1%} wanted): "
            "take more views, closer, the board leaning 20 to 40 degrees in all directions"
        )
    if (rayless := rayless_share(fit.camera)) > MOST_RAYLESS:
        complaints.append(
            f"the distortion folds within the picture: {rayless:.0%} of it has no direction; show the board at the "
            "picture's edges, and if that does not help the lens is too wide for this model"
        )
    covered = float(np.mean(covered_cells(fit.views, size_px) > 0))
    if covered < LEAST_COVERED:
        bare = ", ".join(bare_places(fit.views, size_px))
        complaints.append(f"not enough coverage ({covered:.0%} of the picture): show the board at {bare}")
    elif (worst := float(np.max(fit.ray_sigma_px))) > RAY_SIGMA_SHARE * width:
        where = np.unravel_index(int(np.argmax(fit.ray_sigma_px)), fit.ray_sigma_px.shape)
        rows, columns = fit.ray_sigma_px.shape
        place = _THIRDS[int(where[0]) * 3 // rows][int(where[1]) * 3 // columns]
        complaints.append(f"directions are uncertain by {worst:.1f} px at {place}: show more of the board there")
    if fit.rms_px > HIGH_ERROR * width:
        complaints.append(
            f"high error ({fit.rms_px:.2f} px): is the board flat, its squares as stated, "
            "camera and board held still, the focus fixed?"
        )
    if len(dropped) > 0.25 * (used + len(dropped)):
        complaints.append(f"{len(dropped)} of {used + len(dropped)} views contradict the others: hold the board still")
    return Verdict(tuple(complaints))


def report(fit: Fit, dropped: list[View]) -> str:
    """The numbers, a line each."""
    camera = fit.camera
    names = fit.model.parameters
    values = dict(zip(names, (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion), strict=True))
    lines = [f"lens: {fit.why}"] * bool(fit.why) + [f"distortion model: {fit.model.name}"]
    for name in names:
        unit, digits = (" px", 3) if name[0] in "fc" else ("", 5)
        held = name[0] not in "fc" and name not in fit.model.name.split()
        lines.append(f"{name:<3} {values[name]:>11.{digits}f}{unit}" + (
            "  (not needed)" if held else f"  +- {fit.sigmas[name]:.{digits}f}"))  # fmt: skip
    tilts = np.abs(fit.tilts_deg())
    lines += [
        f"views: {len(fit.views)} used" + "".join(f", {view.name or 'one'} dropped" for view in dropped),
        f"reprojection error: {fit.rms_px:.3f} px rms, worst view {fit.view_rms_px.max():.3f} px",
        f"tilts: up to {tilts[:, 0].max():.0f} deg forwards or backwards, {tilts[:, 1].max():.0f} deg to the sides",
        f"covered: {np.mean(covered_cells(fit.views, camera.size_px) > 0):.0%} of the picture; "
        f"directions known to {fit.ray_sigma_px.max():.2f} px at worst",
    ]
    if rayless := rayless_share(camera):
        lines.append(f"beyond the distortion's fold, without direction: {rayless:.1%} of the picture")
    return "\n".join(lines)


def coverage_picture(fit: Fit, verdict: Verdict) -> NDArray[np.uint8]:
    """A picture (H, W, 3), BGR, of the corners with their residuals magnified. Cells without corners are red."""
    width, height = fit.camera.size_px
    scale = max(1, round(960 / width))
    canvas = np.full((height * scale, width * scale, 3), 255, np.uint8)
    for (row, column), count in np.ndenumerate(covered_cells(fit.views, fit.camera.size_px)):
        top, bottom = (int(h * height * scale / CELLS[1]) for h in (row, row + 1))
        left, right = (int(w * width * scale / CELLS[0]) for w in (column, column + 1))
        if count == 0:
            canvas[top:bottom, left:right] = (210, 210, 255)
        cv2.rectangle(canvas, (left, top), (right, bottom), (225, 225, 225), 1)
    # The arrow of an rms residual is a fiftieth of the picture long.
    longer = width * scale / 50.0 / max(fit.rms_px, 1e-6)
    for number, (view, residuals) in enumerate(zip(fit.views, fit.residuals_px, strict=True)):
        hue = np.array([[[int(number * 180 / len(fit.views)), 200, 170]]], np.uint8)
        colour = tuple(int(c) for c in cv2.cvtColor(hue, cv2.COLOR_HSV2BGR)[0, 0])
        for uv, residual in zip(view.uv_px, residuals, strict=True):
            start = (uv + 0.5) * scale
            end = start + residual * longer
            a, b = ((round(float(p[0])), round(float(p[1]))) for p in (start, end))
            cv2.circle(canvas, a, 2 * scale, colour, -1, cv2.LINE_AA)
            cv2.arrowedLine(canvas, a, b, colour, 1, cv2.LINE_AA, tipLength=0.3)
    caption = f"{len(fit.views)} views, {fit.rms_px:.3f} px rms, arrows {longer / scale:.0f} times as long; " + (
        "good" if verdict.is_good else "not good")  # fmt: skip
    strip = np.full((26 * scale, width * scale, 3), 255, np.uint8)
    cv2.putText(strip, caption, (6, 18 * scale), cv2.FONT_HERSHEY_SIMPLEX, 0.5 * scale, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([canvas, strip])
