"""Cars that stand and drive off, over a recorded autopilot's flight: followed, or lost, and never left behind."""

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks.short_flight import first_sets
from benchmarks.tracks import over_ellipse
from contract.geodesy import LocalFrame
from contract.track import TrackState
from onboard.config.schema import parse_config
from onboard.tracks.track_book import TrackBook

pytestmark = pytest.mark.long

LATE, APART = 5, 10  # pictures from a click to the track's beginning, and from one round of clicks to the next
MARGIN_PX, OFF_PX = 40.0, 2.0


def test_no_report_of_a_car_that_drives_off_is_beyond_three_ellipses_and_few_are_left_standing(
    shared_data: Path,
) -> None:
    folder = shared_data / "movers_start"
    truth: dict[tuple[int, str], dict[str, float]] = {}
    with (folder / "movers.csv").open(newline="") as lines:
        for row in csv.DictReader(lines):
            truth[int(row["frame"]), row["name"]] = {k: float(v) for k, v in row.items() if k != "name"}
    names = sorted({name for _, name in truth})
    pictures = first_sets(folder, parse_config(""))
    ratios, left, followed, kept = [], [], 0, []
    rng = np.random.default_rng(0)
    for clicked in range(20, len(pictures) - 60, 3 * APART):
        book, of_track, last = TrackBook("uav"), dict[int, str](), dict[int, TrackState]()
        begun = clicked + LATE
        for number in range(max(clicked - 40, 0), len(pictures)):
            frame, its_set = pictures[number]
            book.picture(frame, its_set)
            if number == begun:
                for name in names:
                    t = truth.get((pictures[clicked][0].index, name))
                    if t is None or not t["inside"] or t["covered"] > 0.0:
                        continue
                    angle = rng.uniform(0.0, 2.0 * np.pi)
                    uv = t["u"] + OFF_PX * np.cos(angle), t["v"] + OFF_PX * np.sin(angle)
                    if (
                        MARGIN_PX < uv[0] < 600.0
                        and MARGIN_PX < uv[1] < 440.0
                        and book.start(len(of_track) + 1, uv, pictures[clicked][0].index)
                    ):
                        of_track[len(of_track) + 1] = name
            for report in book.reports() if number >= begun else ():
                t = truth.get((report.frame, of_track[report.number]))
                last[report.number] = report.state
                if t is None or report.place is None or report.state is not TrackState.FOLLOWED:
                    continue
                place = LocalFrame(t["lat"], t["lon"], 0.0)
                off = place.to_enu(report.place.lat_deg, report.place.lon_deg, 0.0)[:2]
                ratios.append(over_ellipse(report.place.ellipse, off))
                followed += 1
                is_under_way = np.hypot(t["ve"], t["vn"]) > 2.0
                left.append(bool(is_under_way and "at rest" in report.course_text))
        kept += [state is not TrackState.LOST for state in last.values()]
    assert followed > 1200
    assert np.max(ratios) < 3.0, (np.quantile(ratios, [0.5, 0.9, 0.99, 1.0]), np.mean(left), np.mean(kept))
    assert np.mean(np.array(ratios) < 1.0) > 0.85
    assert np.mean(left) < 0.01
    assert np.mean(kept) > 0.4  # the others leave the picture
