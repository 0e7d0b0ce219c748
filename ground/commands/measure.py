"""`pc-ground measure`: distance, bearing and height difference between two pixels, each with one sigma."""

from __future__ import annotations

import argparse
import json
import math
import sys
from contextlib import closing
from functools import partial

from contract.answer import Fix, Refusal
from contract.errors import LinkError
from contract.locate import Locator
from ground.commands import ANSWERED, REFUSED
from ground.commands.sources import (
    Clicker,
    Source,
    add_interpolated_argument,
    add_source_arguments,
    source_of,
)
from ground.commands.values import age, finite, frame_number
from ground.freshness import MAX_AGE_S
from ground.link_options import UsageError
from ground.pins.fusion import Place, Vector, between
from ground.two_sets import difference_covariance

EXAMPLES = """\
examples:
  pc-ground measure 100 200 130 220                                     a roof over the ground next to it
  pc-ground measure 100 200 500 220 --frame 14 --from SESSION.mcap           two pixels of one picture
  pc-ground measure 100 200 90 400 --frame 14 --frame2 30 --from SESSION.mcap    of two pictures
"""

End = tuple[Locator, Fix]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `measure`."""
    for name, meaning in (("u1", "first pixel's column"), ("v1", "its row"), ("u2", "second pixel's column"),
                          ("v2", "its row")):  # fmt: skip
        parser.add_argument(name, metavar=name.upper(), type=finite, help=meaning)
    parser.add_argument(
        "--frame", metavar="N", type=frame_number, help="the first pixel's picture (default the newest)"
    )
    parser.add_argument("--frame2", metavar="M", type=frame_number, help="the second's (default the first's)")
    add_interpolated_argument(parser)
    add_source_arguments(parser)
    parser.add_argument(
        "--max-age", metavar="S", type=age, help=f"refuse the newest picture if older (default {MAX_AGE_S:g})"
    )
    parser.add_argument("--json", action="store_true", help="as a JSON object")


def run(args: argparse.Namespace) -> int:
    """Do it; returns the exit status. Raises PointclickError."""
    if args.frame2 is not None and args.frame is None:
        raise UsageError("--frame2 needs --frame")
    if args.max_age is not None and args.frame is not None:
        raise UsageError("--max-age is about the newest picture: leave it out with --frame")
    with closing(source_of(args)) as source:
        ends = _ends(args, source)
    if isinstance(ends, int):
        return ends
    (first, one), (second, two) = ends
    v = measured(first, one, (args.u1, args.v1), second, two, (args.u2, args.v2))
    print(_json(v, one, two) if args.json else _text(v, one, two))
    return ANSWERED


def _ends(args: argparse.Namespace, source: Source) -> tuple[End, End] | int:
    """Both clicks' answers, each with what gave it, or the exit status where one is refused. Raises PointclickError."""
    usual_s = MAX_AGE_S if args.frame is None and not source.is_recorded else math.inf
    clicker = partial(Clicker, source, is_measured=not args.interpolated)
    one, first = clicker(usual_s if args.max_age is None else args.max_age).click(args.u1, args.v1, frame=args.frame)
    if isinstance(one, Refusal) or first is None:
        return _refused(one, "first", as_json=args.json)
    # The newest picture may be another one by now: both pixels are of the same.
    by_frame, frame = clicker(math.inf), first.feature_set.frame if args.frame2 is None else args.frame2
    two, second = by_frame.click(args.u2, args.v2, frame=frame)
    if isinstance(two, Refusal) or second is None:
        return _refused(two, "second", as_json=args.json)
    if first.feature_set.session != second.feature_set.session:
        raise LinkError("the aircraft's program began again between both questions: measure again")
    if frame == first.feature_set.frame and not is_same_set(first, second):  # it was revised in between
        again, now = by_frame.click(args.u1, args.v1, frame=frame)
        if isinstance(again, Fix) and now is not None:
            one, first = again, now
    return (first, one), (second, two)


def measured(
    first: Locator, one: Fix, uv1_px: tuple[float, float], second: Locator, two: Fix, uv2_px: tuple[float, float]
) -> Vector:
    """The vector from one answered click to another; what their errors share cancels."""
    if is_same_set(first, second):
        covariance = first.difference_covariance(uv1_px, uv2_px, second=second)
    else:
        covariance = difference_covariance(first.feature_set, one, second.feature_set, two)
    return between(_place(one), _place(two), covariance)


def is_same_set(first: Locator, second: Locator) -> bool:
    """Return whether both answer by one set, whichever of its pixels were measured."""
    a, b = first.feature_set, second.feature_set
    return (a.vehicle, a.session, a.frame, a.revision) == (b.vehicle, b.session, b.frame, b.revision)


def _place(fix: Fix) -> Place:
    return Place(fix.lat_deg, fix.lon_deg, fix.height_ellipsoid_m, fix.height_amsl_m, fix.covariance_enu_m2)


def _text(v: Vector, one: Fix, two: Fix) -> str:
    """The vector in a line, and in another how both ends were found."""
    return f"{text_of(v)}\nfrom: {one.method_text}; to: {two.method_text}"


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


def _refused(answer: object, which: str, *, as_json: bool) -> int:
    assert isinstance(answer, Refusal)
    if as_json:
        print(answer.to_json())
    else:
        print(f"{which} pixel: {answer.to_text()}", file=sys.stderr)
    return REFUSED
