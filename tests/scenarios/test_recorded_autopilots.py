"""The table of recorded autopilots: their telemetry over simulated ground, what is wrong, and how clicks score.

In `ratio` an error is counted in radii of its own 90 % ellipse. Where several draws are named, bounds on ratios hold of
all their clicks together, for one draw is one error of the GPS.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark import ParameterSet

from benchmarks.autopilots import SENSORS, STARTS, Scene, judge, seed_of
from benchmarks.click_score import STEEP_DEG, Score
from benchmarks.platform_faults import BELIEVED, FAULTS
from benchmarks.sampled_flight import replace_section
from onboard.config.schema import parse_config
from onboard.estimation.platform_states import OFFSET

Bounds = tuple[float, float]


@dataclass(frozen=True)
class Row:
    """One claim: a recording and the seconds of it, the sensors used, the fault, the draws, and what is expected."""

    claim: str
    recording: str
    sensors: str
    seconds: float
    seeds: tuple[int, ...]
    answered: float = 0.0  # of each draw's clicks, more than
    answered_pooled: float = 0.0  # of all draws' clicks, more than
    inside: Bounds = (0.0, 1.0)  # share within the 90 % ellipse
    inside_steep: Bounds | None = None  # the same above and below 30 degrees of bank, at least: steep, others
    clicks: int = 1  # that are answered, at least
    steep: int = 0  # of these, above 30 degrees of bank
    worst: float = math.inf  # ratio
    q90: Bounds = (0.0, math.inf)  # of the ratio; 1 is right
    q90_steep: float = 0.0  # the same above 30 degrees of bank, at least
    median_m: float = math.inf  # error of each draw
    q90_m: float = math.inf  # error
    semi_m: float = math.inf  # median semi-major axis of each draw
    # By how many of its sigmas the delay that is learned may be off, and how large that sigma (s) may be.
    delay: Bounds | None = None
    start_s: float | None = None  # None: as the benchmark begins it
    warm_s: float = 30.0
    fault: str = "none"
    attitude_hz: float | None = None
    readout_s: float = 0.0
    of_benchmark: bool = False  # seeds count from that of `benchmarks.autopilots --seed 3`
    others: tuple[str, ...] = ()  # recordings whose draws are pooled with these
    long: str = ""  # where `make test` shows the same, or why it cannot

    def first(self, name: str) -> int:
        return seed_of(name, 3) if self.of_benchmark else 0

    def scores(self) -> list[Score]:
        """Fly every draw, and check each alone."""
        config = replace_section(parse_config(""), "solve", **SENSORS[self.sensors])
        config = replace_section(config, "camera", readout_s=self.readout_s, **BELIEVED.get(self.fault, {}))
        scores = []
        for name in (self.recording, *self.others):
            start_s = STARTS[name] if self.start_s is None else self.start_s
            plain = Scene(name, config, start_s, self.seconds, attitude_hz=self.attitude_hz, readout_s=self.readout_s)
            scene = replace(plain, **FAULTS[self.fault])
            scores += [self.alone(judge(scene, self.first(name) + seed, self.warm_s), scene) for seed in self.seeds]
        return scores

    def alone(self, score: Score, scene: Scene) -> Score:
        assert score.answered["all"] > self.answered * score.asked["all"]
        assert np.median(score.error_m) < self.median_m
        assert np.median(score.semi_m) < self.semi_m
        if self.delay is not None:
            assert score.learned_values is not None
            mean, sigma_s = (float(values[OFFSET]) for values in score.learned_values)
            assert abs(mean + scene.stamps_late_s) < self.delay[0] * sigma_s
            assert sigma_s < self.delay[1]
        return score

    def check(self) -> None:
        scores = self.scores()
        ratio, bank, error = (np.concatenate([getattr(s, n) for s in scores]) for n in ("ratio", "bank_deg", "error_m"))
        steep = bank > STEEP_DEG
        assert len(ratio) >= self.clicks and np.count_nonzero(steep) >= self.steep
        assert len(ratio) > self.answered_pooled * sum(s.asked["all"] for s in scores)
        assert self.inside[0] <= np.mean(ratio < 1.0) <= self.inside[1]
        if self.inside_steep is not None:
            assert np.mean(ratio[steep] < 1.0) > self.inside_steep[0]
            assert np.mean(ratio[~steep] < 1.0) >= self.inside_steep[1]
        assert ratio.max() < self.worst
        assert self.q90[0] < np.quantile(ratio, 0.9) < self.q90[1]
        assert not self.q90_steep or np.quantile(ratio[steep], 0.9) > self.q90_steep
        assert np.quantile(error, 0.9) < self.q90_m


CLIMB = Row("", "qp_climb", "gps", 30.0, (), answered=0.65, inside=(0.85, 1.0), worst=2.0, median_m=12.0, semi_m=25.0,
            start_s=0.0, warm_s=2.5)  # fmt: skip
BANKS = Row("", "", "gps", 240.0, (), answered=0.65, inside_steep=(0.85, 0.85), steep=41, q90_m=18.0, semi_m=25.0,
            start_s=0.0, long="with all sensors: tests/test_benchmarks.py")  # fmt: skip
HILLS = Row(
    "", "", "", 240.0, (), worst=2.0, q90=(0.4, math.inf), fault="hills", of_benchmark=True, long="many minutes each"
)
STREAM = Row("", "", "full", 90.0, (7,), inside=(0.8, 1.0), clicks=51, q90=(0.3, math.inf), delay=(3.0, 0.05),
             warm_s=8.0, long="a minute of it")  # fmt: skip

TABLE = [
    # Nearly straight up, on camera and GPS alone, then banking and changing to cruise. Before, three of four grounds
    # and GPS errors gave orientations turned by up to 170 degrees, and clicks 10.6 ellipses off. Over 30 % of the
    # height above ground a radius is no answer (`uncertain`): early in the climb some are.
    replace(CLIMB, claim="a climb on camera and GPS is answered and its ellipses hold", seeds=(2, 3, 4, 5, 6, 7),
            long="the row of banks read in turn"),
    # What a turn tilts stays tilted. Before, the ground's weight fell as the ground was tilted, (5.9): above 30 degrees
    # of bank 67 and 80 % were inside. 90 % of errors: of six draws 13 to 18 m, the last digits the processor's; before,
    # 36 m. A minute of it is without positions.
    replace(BANKS, claim="banks are as honest as level flight, with an outage", recording="plane_gps_outage",
            seeds=(10,)),
    replace(BANKS, claim="banks are as honest as level flight, in wind", recording="plane_wind_noise",
            seeds=(11,)),
    # Of four pictures at 60 degrees another orientation was, 540 m off, with 70 m stated (8.5 ellipses). The right one
    # was not found, though sought from 13 degrees next to it: its adjustment crept along a valley.
    Row("no other orientation is accepted after a steep bank", "plane_wind_noise", "gps", 240.0, (759004,),
        answered=0.7, steep=41, worst=3.0, semi_m=25.0, start_s=60.0,
        long="tests/onboard/estimation/test_bundle_adjustment.py"),
    # This autopilot's heading is 2 degrees behind in steep turns; before, 57 % were inside there. Four samples of the
    # GPS's slow error: one alone has 68 to 98 % inside.
    Row("a heading that turns late is allowed for", "plane_breeze", "full", 240.0, (3, 4, 5, 6),
        inside_steep=(0.85, 0.0), steep=401, q90_steep=0.6, q90_m=9.0, start_s=45.0,
        long="tests/onboard/estimation/test_sensor_factors.py"),
    # Each picture's rate is found with its pose; taken for noise of its features, 58 to 72 % were inside.
    Row("rows read in turn are answered in banks as truth says, by camera and GPS", "plane_turn", "gps", 28.0, (0,),
        answered=0.75, inside=(0.85, 1.0), steep=1, q90_m=25.0, start_s=6.0, warm_s=8.0, readout_s=0.03),
    # The quad climbs from 15 m; a wrong track ended at its first camera and held that in place, (6.16): 7.4 ellipses.
    # The quadplane banks by 56 degrees; a window's newest picture fell into a wrong minimum, which bent the path by 9 m
    # and which the windows after it inherited, (16.11): 4.7 ellipses. And another draw of each.
    *(
        replace(HILLS, claim=f"a climb over hills stays within two ellipses, draw {draw}", recording="quad",
                sensors="full", seeds=(draw,), answered=0.9)
        for draw in (3, 0)
    ),
    *(
        replace(HILLS, claim=f"steep banks over hills stay within two ellipses, draw {draw}", recording="qp_transition",
                sensors="gps", seeds=(draw,), answered=0.7)
        for draw in (2, 1)
    ),
    # Ground shows along the track that it is steeper, and less is claimed across it. Short hills of 6 m; before (14.3)
    # was by the variogram 77 and 63 % were inside, sharpness 1.13 and 1.30.
    # Six draws of each, for all clicks of a minute share one slope that is not known: one sigma of the share inside is
    # 4 points, of two draws it was 8.
    Row("camera and GPS claim as much as they know over ground steeper than declared", "copter_survey", "gps", 120.0,
        (0, 1, 2, 3, 4, 5), of_benchmark=True, others=("quad",), answered_pooled=0.55, inside=(0.82, 0.969),
        q90=(0.75, 1.2), worst=2.2, fault="rough", long="many minutes"),
    # A network stream's delay may be anything up to a second: 0.45 s early or late of the middle that the configuration
    # states for a stream. Taken as linear about that middle windows were wrong for whole flights: 0.5 s off where 0.04
    # was stated. The quad climbs for 70 s, which shows little of a delay.
    replace(STREAM, claim="the delay of a stream late is found within a minute as well as it is stated",
            recording="plane_wind_noise", fault="stream late", seconds=60.0, long="a minute of it"),
    *(
        replace(STREAM, claim=f"the delay of a {fault} is found as well as it is stated, {name}", recording=name,
                fault=fault, attitude_hz=attitude_hz, seconds=150.0 if name == "quad" else 90.0)
        for name, fault, attitude_hz in (
            ("plane_wind_noise", "stream late", None), ("plane_wind_noise", "stream early", 4.0),
            ("plane_breeze", "stream early", None), ("plane_log", "stream late", None),
            ("copter_survey", "stream late", None), ("quad", "stream late", None), ("quad", "stream early", 4.0),
        )
    ),
    # The derivative of a wobble at the wrong offset claimed 0.13 s where 0.45 was off, and had moved away from it. Nor
    # is nothing learned: 0.29 was known before.
    *(
        Row(f"a climb that hardly turns shows no more of the delay of a {fault} than it can", "quad", "full", 90.0,
            (7,), inside=(0.8, 1.0), delay=(2.0, 0.25), warm_s=8.0, fault=fault, attitude_hz=attitude_hz,
            long="the rows above")
        for fault, attitude_hz in (("stream early", 4.0), ("stream late", None))
    ),
]  # fmt: skip


def parameter(row: Row) -> ParameterSet:
    """The row; its short ones of one recording are one worker's, which reads that once."""
    mark = pytest.mark.long if row.long else pytest.mark.xdist_group(f"recorded: {row.recording}")
    return pytest.param(row, id=row.claim.replace(" ", "-"), marks=mark)


@pytest.mark.parametrize("row", [parameter(row) for row in TABLE])
def test_recorded_autopilot(row: Row, request: pytest.FixtureRequest) -> None:
    if not (Path(__file__).parents[1] / "data" / f"{row.recording}.tlog").exists():
        request.getfixturevalue("shared_data")
    row.check()
