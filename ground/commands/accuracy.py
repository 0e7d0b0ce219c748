"""`pc-ground accuracy`: clicks on surveyed marks, how far they are off, and whether the stated ellipses are true."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from contract.answer import CHI2_2, Fix, Refusal
from contract.errors import InputError
from contract.geodesy import LocalFrame
from ground.accuracy_figures import ASPRS_LEAST_MARKS, Figures, figures
from ground.commands import ANSWERED, REFUSED
from ground.commands.picture_rows import read_picture_rows
from ground.commands.sources import Clicker, RecordedSource, add_source_arguments
from ground.commands.values import finite
from ground.formats.split_columns import HALVES, SplitColumns
from ground.link_options import UsageError

EXAMPLES = """\
examples:
  pc-ground accuracy --truth MARKS.csv --from SESSION.mcap
  pc-ground accuracy --truth MARKS.csv --from SESSION.mcap --json
  pc-ground accuracy --truth MARKS.csv --from SESSION.mcap --plot marks.png    (needs pointclick[plot])
MARKS.csv has a line for each click on a mark, and names its columns in the first:
  frame (or file),u,v,lat_deg,lon_deg and, if known, height_amsl_m or height_ellipsoid_m, sigma_m (of the survey), name
"""
MAX_MARKS = 100_000


@dataclass(frozen=True)
class Surveyed:
    """One row: a click, and where its mark truly is."""

    name: str
    picture: int | str
    u_px: float
    v_px: float
    lat_deg: float
    lon_deg: float
    height_amsl_m: float | None
    height_ellipsoid_m: float | None
    sigma_m: float


@dataclass(frozen=True)
class Compared:
    """One mark's click, answered: answer minus truth, metres; and how many of its ellipses' radii that is."""

    mark: Surveyed
    east_m: float
    north_m: float
    up_m: float | None
    radii: float  # 1 on the edge of the 90 % ellipse

    @property
    def is_inside(self) -> bool:
        return self.radii <= 1.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `accuracy`."""
    parser.add_argument("--truth", metavar="MARKS.csv", type=Path, required=True)
    add_source_arguments(parser)
    parser.add_argument("--json", action="store_true", help="the figures and every mark as one JSON object")
    parser.add_argument("--plot", metavar="FILE", type=Path, help="a picture of the errors (png, pdf, svg)")


def run(args: argparse.Namespace) -> int:
    """Do it; returns the exit status. Raises PointclickError."""
    if args.recording is None:
        raise UsageError("accuracy needs --from SESSION.mcap: marks are clicked in pictures of the past")
    marks = read_marks(args.truth)
    clicker = Clicker(RecordedSource(args.recording, args.vehicle), math.inf)
    compared, refused = [], []
    for mark in marks:
        by = {"frame": mark.picture} if isinstance(mark.picture, int) else {"file": mark.picture}
        answer, _ = clicker.click(mark.u_px, mark.v_px, **by)
        if isinstance(answer, Refusal):
            refused.append((mark, answer))
        else:
            compared.append(compare(mark, answer))
    for mark, refusal in refused:
        print(f"pc-ground: {mark.name}: {refusal.to_text()}", file=sys.stderr)
    if not compared:
        print(f"none of {len(marks)} clicks was answered", file=sys.stderr)
        return REFUSED
    found = figures(
        np.array([[c.east_m, c.north_m] for c in compared]),
        np.array([c.up_m for c in compared if c.up_m is not None]),
        [c.is_inside for c in compared],
        np.array([c.mark.sigma_m for c in compared]),
    )
    if args.plot is not None:
        plot(compared, found, args.plot)
    if args.json:
        each = [{"name": c.mark.name, **{k: v for k, v in asdict(c).items() if k != "mark"}} for c in compared]
        print(json.dumps({**asdict(found), "refused": len(refused), "each": each}))
    else:
        print(text(found, len(refused)))
    return ANSWERED


def compare(mark: Surveyed, fix: Fix) -> Compared:
    """Answer minus truth. The survey's own error counts with the answer's."""
    pairs = ((fix.height_ellipsoid_m, mark.height_ellipsoid_m), (fix.height_amsl_m, mark.height_amsl_m))
    up = next((a - b for a, b in pairs if a is not None and b is not None), None)
    level = fix.height_ellipsoid_m if fix.height_ellipsoid_m is not None else fix.height_amsl_m or 0.0
    east, north, _ = (
        float(c) for c in LocalFrame(mark.lat_deg, mark.lon_deg, level).to_enu(fix.lat_deg, fix.lon_deg, level)
    )
    C = fix.covariance_enu_m2[:2, :2] + mark.sigma_m**2 * np.eye(2)
    d = np.array([east, north])
    return Compared(mark, east, north, up, math.sqrt(float(d @ np.linalg.solve(C, d)) / CHI2_2))


def text(f: Figures, refused: int) -> str:
    """A table, and the verdict last."""

    def metres(value: float | None) -> str:
        return "not known" if value is None else f"{value:.2f} m"

    few = "" if f.marks >= ASPRS_LEAST_MARKS else f" (ASPRS asks for {ASPRS_LEAST_MARKS} marks; these are {f.marks})"
    bias = "more than chance" if f.bias_significant else "no more than chance"
    rows = [
        ("marks", f"{f.marks} answered, {refused} refused"),
        ("RMSE east, north", f"{metres(f.rmse_east_m)}, {metres(f.rmse_north_m)}"),
        ("RMSE radial", metres(f.rmse_radial_m)),
        ("RMSE height", metres(f.rmse_height_m)),
        ("bias east, north", f"{f.bias_east_m:+.2f} m, {f.bias_north_m:+.2f} m: {bias}"),
        ("bias height", "not known" if f.bias_height_m is None else f"{f.bias_height_m:+.2f} m"),
        ("CEP, CE90", f"{metres(f.cep_m)}, {metres(f.ce90_m)}"),
        ("LE90", metres(f.le90_m)),
        ("ASPRS RMSE_H", f"{metres(f.asprs_rmse_h_m)}, the survey's error with it{few}"),
        ("NSSDA 95 %", f"{metres(f.nssda_radial_95_m)} horizontally, {metres(f.nssda_height_95_m)} in height"),
        (
            "coverage",
            f"{f.coverage:.1%} inside the stated 90 % ellipse; between {f.coverage_low:.1%} and {f.coverage_high:.1%} "
            "(95 %, if the errors were independent; those of one flight are not)",
        ),
        ("verdict", f.verdict),
    ]
    return "\n".join(f"{name:<18} {value}" for name, value in rows)


def read_marks(path: Path) -> list[Surveyed]:
    """All rows, checked. Raises InputError with the line's number."""
    out = read_picture_rows(
        path, ("u", "v", "lat_deg", "lon_deg"), _surveyed, "see pc-ground accuracy --help", MAX_MARKS
    )
    if not out:
        raise InputError(f"{path}: no marks in it")
    return out


def _place(row: dict[str, str]) -> tuple[float, float]:
    """Latitude and longitude, with what columns next to them state of either: minutes, hemisphere, system. Raises
    InputError.
    """
    names, cells = list(row), list(row.values())
    split = SplitColumns.of(names, {half: names.index(half) for half in HALVES})
    split.check_system(cells)
    return split.place(cells, row) or (finite(row["lat_deg"]), finite(row["lon_deg"]))


def _surveyed(row: dict[str, str], picture: int | str, number: int) -> Surveyed:
    def optional(name: str) -> float | None:
        cell = row.get(name, "").strip()
        return finite(cell) if cell else None

    lat, lon = _place(row)
    if not (-90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0):
        raise ValueError(f"{lat:g} {lon:g} is no latitude and longitude")
    sigma = optional("sigma_m") or 0.0
    if sigma < 0.0:
        raise ValueError(f"sigma_m {sigma:g} is below 0")
    return Surveyed(
        row.get("name", "").strip() or f"mark {number}", picture, finite(row["u"]), finite(row["v"]),
        lat, lon, optional("height_amsl_m"), optional("height_ellipsoid_m"), sigma,
    )  # fmt: skip


def plot(compared: list[Compared], found: Figures, path: Path) -> None:
    """Errors east and north, with the circles that hold half and 90 % of them. Raises InputError without the extra."""
    try:
        import matplotlib as mpl  # noqa: PLC0415

        mpl.use("Agg")
        import matplotlib.pyplot as plt  # noqa: PLC0415
    except ImportError as error:
        raise InputError(
            "this needs the package matplotlib: install pointclick with its extra [plot] (README)"
        ) from error
    figure, axes = plt.subplots(figsize=(6, 6))
    for is_inside, marker, label in ((True, "o", "inside its ellipse"), (False, "x", "outside its ellipse")):
        these = [c for c in compared if c.is_inside is is_inside]
        axes.scatter(
            [c.east_m for c in these], [c.north_m for c in these], s=14, marker=marker, label=f"{len(these)} {label}"
        )
    for radius, style, label in ((found.cep_m, "--", "CEP"), (found.ce90_m, "-", "CE90")):
        axes.add_patch(plt.Circle((0, 0), radius, fill=False, linestyle=style, label=f"{label} {radius:.1f} m"))
    axes.plot(found.bias_east_m, found.bias_north_m, "k+", markersize=16, markeredgewidth=2, zorder=5, label="bias")
    axes.set_aspect("equal", "datalim")
    axes.grid(True)
    axes.set_xlabel("error east, m")
    axes.set_ylabel("error north, m")
    axes.legend(loc="upper right")
    try:
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as error:
        raise InputError(f"--plot {path}: {error}") from error
    finally:
        plt.close(figure)
