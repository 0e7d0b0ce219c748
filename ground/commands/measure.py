"""`pc-ground measure`: distance, bearing and height difference between two pixels, each with one sigma."""

from __future__ import annotations

import argparse
import json
import math
import sys

from contract.answer import Fix, Refusal
from contract.locate import Locator
from ground.commands import ANSWERED, REFUSED
from ground.commands.sources import Clicker, add_source_arguments, source_of
from ground.commands.values import age, finite, frame_number
from ground.freshness import MAX_AGE_S
from ground.link_options import UsageError
from ground.pins.fusion import Place, Vector, between
from ground.two_sets import difference_covariance

EXAMPLES = """\
examples:
  pc-ground measure 100 200 500 220                                          two pixels of the newest picture
  pc-ground measure 100 200 500 220 --frame 14 --from SESSION.mcap           two pixels of one picture
  pc-ground measure 100 200 90 400 --frame 14 --frame2 30 --from SESSION.mcap    of two pictures
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `measure`."""
    for name, meaning in (("u1", "first pixel's column"), ("v1", "its row"), ("u2", "second pixel's column"),
                          ("v2", "its row")):  # fmt: skip
        parser.add_argument(name, metavar=name.upper(), type=finite, help=meaning)
    parser.add_argument(
        "--frame", metavar="N", type=frame_number, help="the first pixel's picture (default the newest)"
    )
    parser.add_argument("--frame2", metavar="M", type=frame_number, help="the second's (default the first's)")
    add_source_arguments(parser)
    parser.add_argument(
        "--max-age", metavar="S", type=age, help=f"refuse the newest picture if older (default {MAX_AGE_S:g})"
    )
    parser.add_argument("--format", choices=("text", "json"), default="text")


def run(args: argparse.Namespace) -> int:
    """Do it; returns the exit status. Raises PointclickError."""
    if args.frame2 is not None and args.frame is None:
        raise UsageError("--frame2 needs --frame")
    if args.max_age is not None and args.frame is not None:
        raise UsageError("--max-age is about the newest picture: leave it out with --frame")
    source = source_of(args)
    usual_s = MAX_AGE_S if args.frame is None and not source.is_recorded else math.inf
    clicker = Clicker(source, usual_s if args.max_age is None else args.max_age)
    one, first = clicker.click(args.u1, args.v1, frame=args.frame)
    if isinstance(one, Refusal) or first is None:
        return _refused(one, "first", args.format)
    # The newest picture may be another one by now: both pixels are of the same.
    if args.frame2 is None or args.frame2 == args.frame:
        two, second = first.locate((args.u2, args.v2)), first
    else:
        found, other = clicker.click(args.u2, args.v2, frame=args.frame2)
        if other is None:
            return _refused(found, "second", args.format)
        two, second = found, other
    if isinstance(two, Refusal):
        return _refused(two, "second", args.format)
    v = measured(first, one, (args.u1, args.v1), second, two, (args.u2, args.v2))
    print(_json(v, one, two) if args.format == "json" else text_of(v))
    return ANSWERED


def measured(
    first: Locator, one: Fix, uv1_px: tuple[float, float], second: Locator, two: Fix, uv2_px: tuple[float, float]
) -> Vector:
    """The vector from one answered click to another; what their errors share cancels."""
    if first is second:
        covariance = first.difference_covariance(uv1_px, uv2_px)
    else:
        covariance = difference_covariance(first.feature_set, one, second.feature_set, two)
    return between(_place(one), _place(two), covariance)


def _place(fix: Fix) -> Place:
    return Place(fix.lat_deg, fix.lon_deg, fix.height_ellipsoid_m, fix.height_amsl_m, fix.covariance_enu_m2)


def text_of(v: Vector) -> str:
    """One line; sigmas are one sigma."""

    def with_sigma(value: str, sigma: float | None, unit: str) -> str:
        return f"{value} {unit}" if sigma is None else f"{value} +-{sigma:.2f} {unit}"

    parts = [
        with_sigma(f"{v.distance_m:.2f}", v.sigma_distance_m, "m"),
        "bearing " + with_sigma(f"{v.bearing_deg:.2f}", v.sigma_bearing_deg, "deg"),
    ]
    if v.height_difference_m is None:
        parts.append("height difference not known")
    else:
        parts.append("height " + with_sigma(f"{v.height_difference_m:+.2f}", v.sigma_height_difference_m, "m"))
    return ", ".join(parts) + " (one sigma)"


def vector_json(v: Vector) -> dict[str, float | None]:
    return {name: None if value is None else round(value, 4) for name, value in vars(v).items()}


def _json(v: Vector, one: Fix, two: Fix) -> str:
    ends = {"from": json.loads(one.to_json()), "to": json.loads(two.to_json())}
    return json.dumps({"status": "ok", **vector_json(v), **ends})


def _refused(answer: object, which: str, form: str) -> int:
    assert isinstance(answer, Refusal)
    if form == "json":
        print(answer.to_json())
    else:
        print(f"{which} pixel: {answer.to_text()}", file=sys.stderr)
    return REFUSED
