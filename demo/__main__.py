"""`python -m demo`: fly, follow, click, and draw what came of it. Takes a minute; needs no network."""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from pathlib import Path

import numpy as np

from contract.errors import PointclickError
from contract.geodesy import LocalFrame
from demo.clicks import Clicked, Spot, choose_spots
from demo.processes import Aircraft, program
from ground.recording import Recording
from simulation.flight import DescribedSpec, RecordedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec
from simulation.truth import Truth

MOUNT_DEG = (0.0, -90.0, -90.0)  # down, the camera's x axis along the nose: the seed's mount
RATE_HZ = 4.0
START_S = 3.0  # into tests/data/plane_turn: straight and level, 20 m/s, 250 m above the ground
SPEED = 3.0  # times real time
SEED = 3
HEADER = "  spot  frame      pixel   latitude deg  longitude deg  height  radius 90%  true error"
PATH = PathSpec("turns", leg_m=150.0)
FLIGHTS: dict[str, RecordedSpec | DescribedSpec] = {
    "ordinary": DescribedSpec(PATH, ordinary(SEED), seed=SEED),
    "declared": DescribedSpec(PATH, seed=SEED),
    "recorded": RecordedSpec("plane_turn", START_S, whole_log=False),
}


def main(arguments: list[str] | None = None) -> int:
    """Run the demo; 0 if every click was answered, 1 if one was refused, 2 if something did not work."""
    parser = argparse.ArgumentParser(prog="python -m demo", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/demo"), metavar="DIR", help="default out/demo")
    parser.add_argument("--seconds", type=float, default=14.0, metavar="S", help="length of the flight (default 14)")
    parser.add_argument(
        "--autopilot",
        choices=tuple(FLIGHTS),
        default="ordinary",
        help="ordinary: a described flight with an ordinary autopilot's errors (default); declared: with those that "
        "the configuration declares; recorded: along a real autopilot's recording",
    )
    options = parser.parse_args(arguments)
    try:
        return _run(options.out, options.seconds, options.autopilot)
    except PointclickError as error:
        print(f"demo: error: {error}", file=sys.stderr)
        return 2


def _run(out: Path, seconds: float, autopilot: str) -> int:
    began = time.monotonic()
    shutil.rmtree(out, ignore_errors=True)
    flight, recording = out / "flight", out / "session.mcap"
    spec = SessionSpec(
        FLIGHTS[autopilot],
        seconds=seconds,
        rate_hz=RATE_HZ,
        mount_deg=MOUNT_DEG,
        terrain=TerrainSpec(relief_m=20.0, wavelength_m=250.0),
        level_ground=True,
    )
    _say(
        f"Flying {seconds:g} s over simulated ground, autopilot: {autopilot}; "
        f"250 m up, 20 m/s, {RATE_HZ:g} pictures a second"
    )
    truth = fly(spec, flight, _progress)

    with Aircraft(flight, recording, SPEED, len(truth)) as aircraft:
        _say(f"On board: {aircraft.command}")
        _say(f"On the ground, while it flies ({SPEED:g} times real time):")
        spots = choose_spots(truth)
        clicked = _click_all(truth, spots, aircraft)
        summary = aircraft.land()
    _say("On board, in the end:\n" + "\n".join(f"  {line}" for line in summary.splitlines()))

    from demo.map import draw_overview  # noqa: PLC0415  Matplotlib, a second of processor time, before take-off
    from demo.tracks import draw_tracks, follow  # noqa: PLC0415

    tracked = follow(flight)
    pictures = [
        *draw_tracks(tracked, out),
        *draw_overview(truth, spec.texture, Recording(recording), tracked, spots, clicked, out),
    ]
    _say("Pictures to look at:\n" + "\n".join(f"  {picture}" for picture in pictures))
    _say(
        f"The flight on a page, to click its pictures:  make demo-web\n  {program('pc-ground')} web --from {recording}"
    )
    answered = sum(c.error_m is not None for c in clicked)
    print(f"\n{answered} of {len(clicked)} clicks answered, {time.monotonic() - began:.0f} s in all")
    return 0 if answered == len(clicked) else 1


def _click_all(truth: Truth, spots: list[Spot], aircraft: Aircraft) -> list[Clicked]:
    """Each spot's pixels through `pc-ground click`, a table as the answers come."""
    rows = sorted(((spot, view) for spot in spots for view in spot.views), key=lambda row: row[1].frame)
    first = rows[0][1]
    print(f"  pc-ground click {first.u_px} {first.v_px} --frame {first.frame} --connect {aircraft.endpoint}\n")
    print(HEADER)
    clicked: list[Clicked] = []
    for spot, view in rows:
        answer = aircraft.click(view.u_px, view.v_px, view.frame)
        head = head_text(spot.name, view.frame, view.u_px, view.v_px)
        if answer["status"] != "ok":
            print(f"{head}   refused: {answer['status']}", flush=True)
            clicked.append(Clicked(spot, view, answer, None, None))
            continue
        there = LocalFrame(truth.origin.lat_deg, truth.origin.lon_deg, truth.origin.height_m - truth.undulation_m)
        enu_m = there.to_enu(answer["lat_deg"], answer["lon_deg"], answer["height_amsl_m"])
        error_m = float(np.hypot(*(enu_m - spot.enu_m)[:2]))
        clicked.append(Clicked(spot, view, answer, enu_m, error_m))
        where = answer["lat_deg"], answer["lon_deg"], answer["height_amsl_m"]
        print(row_text(head, where, answer["ellipse"]["semi_major_m"], error_m), flush=True)
    return clicked


def head_text(spot: str, frame: int, u_px: int, v_px: int) -> str:
    """The clicked spot, frame and pixel as the first columns under `HEADER`."""
    return f"  {spot:<4}  {frame:5d}  {u_px:4d},{v_px:4d}"


def row_text(head: str, where: tuple[float, float, float], radius_m: float, error_m: float) -> str:
    """A line of the table: latitude, longitude (degrees) and height (m) of an answer next to its true error."""
    lat_deg, lon_deg, height_m = where
    return f"{head}  {lat_deg:13.7f}  {lon_deg:13.7f}  {height_m:4.0f} m  {radius_m:8.1f} m  {error_m:8.1f} m"


def _say(text: str) -> None:
    print(f"\n{text}", flush=True)


def _progress(done: int, of: int) -> None:
    if sys.stderr.isatty():
        print(f"\r  picture {done} of {of}", end="\n" if done == of else "", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
