"""The table of scenarios: a rendered flight, what is wrong on it, and what becomes of its pictures and clicks.

To be read like a page. `SOLVED`: 90 % of the pictures answer, within 8 m, 97 % inside their 99 % ellipses, which are
none that hold anything; `refused`: not one click is answered, for these reasons and no others; `either`: what is
answered holds. A row with `long` is of `make test-long`, and names what shows the same in `make test`.
"""

from dataclasses import replace

import pytest

from contract.feature_set import Status
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.renderer import SensorSpec
from simulation.telemetry import TelemetrySpec
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from tests.scenarios.scenario import (
    ANSWERS,
    MANY,
    SOLVED,
    Expected,
    Scenario,
    as_parameters,
    either,
    refused,
    solved,
    unsolved,
)
from tests.scenarios.sessions import (
    FAST,
    HOVER,
    LARGE,
    LEG,
    LEPTON,
    LOW,
    LOW_HOVER,
    ROTATION,
    along,
    apart,
    ordinary_turns,
    over,
    photographs,
)
from tests.scenarios.spoiling import (
    LevelTerrain,
    between,
    black,
    cut_to_the_second,
    defocused,
    pictures,
    silence,
    white,
    without_fix,
)

OK, STARTING, BAD_PICTURE = Status.OK, Status.STARTING, Status.BAD_PICTURE
FEATURELESS, POOR_FIT, REPETITIVE = Status.FEATURELESS, Status.POOR_FIT, Status.REPETITIVE
LOW_PARALLAX, NO_GPS, UNSYNCHRONISED = Status.LOW_PARALLAX, Status.NO_GPS, Status.UNSYNCHRONISED
NO_ATTITUDE, LEVEL_GROUND = ("solve.attitude", "none"), ("solve.level_ground", True)
STRAIGHT = PathSpec("straight")
SILENT_ATTITUDE = along(STRAIGHT, TelemetrySpec(attitude_hz=0.0))
OVER_TERRAIN = Scenario("hover over known terrain", HOVER, SOLVED, terrain=LevelTerrain())
# Two seconds without a usable picture in the middle, and what is answered before and after.
BLIND = Expected(reasons=(FEATURELESS,), stretches=((0, 9, OK), (9, 15, FEATURELESS), (19, 24, OK)))
# Waves that persist from picture to picture, moving as a whole at 2 to 3 m/s. Nothing but the disagreement of coarse
# and fine flow shows it: taken for land, up to four fifths of the clicks are outside their 99 % ellipse.
WAVES = either(POOR_FIT, FEATURELESS, some=(POOR_FIT, FEATURELESS))
ORDINARY = Expected(answered=0.6, inside_99=0.93, worst=3.0, semi_m=(0.0, 30.0))
CROPS, LOW_CROPS = (
    replace(LARGE, flight=DescribedSpec(PathSpec("straight", height_m=h, speed_m_s=10.0)), seconds=6.0)
    for h in (100.0, 60.0)
)
IN_ROWS = Expected(answered=0.75, worst=3.0, median_m=8.0, semi_m=(0.5, 15.0))
MOUNTS_DEG = ((0.0, -45.0, 0.0), (0.0, -60.0, 90.0), (0.0, -60.0, 0.0), (0.0, -90.0, 90.0), (0.0, -90.0, 180.0))
WHOLE_SECONDS = (("camera.latency_s", -0.5), ("camera.sigma_jitter_s", 0.3))

TABLE: dict[str, list[Scenario]] = {
    # Ground that is hard or impossible to track.
    "ground": [
        Scenario("level ground, every point in one plane, is solved", LEG, SOLVED),
        Scenario("hills of 40 m are solved", replace(LEG, terrain=TerrainSpec(relief_m=40.0)), SOLVED,
                 long="hills of 20 m and of 10: tests/test_end_to_end.py"),
        Scenario("a plain without texture is featureless", over("plain"), refused(FEATURELESS)),
        Scenario("small pictures of water are refused, or their ellipses hold", over("water"),
                 either(FEATURELESS, POOR_FIT, LOW_PARALLAX)),
        Scenario("small pictures of other water are refused, or their ellipses hold", over("water", seed=7),
                 either(FEATURELESS, POOR_FIT, LOW_PARALLAX), long="the row above"),
        Scenario("water from 100 m is a poor fit or wide", over("water", replace(LARGE, flight=LOW)),
                 replace(WAVES, semi_m=(7.0, 1e9))),
        Scenario("the sea from 100 m is a poor fit or wide", over("sea", replace(LARGE, flight=LOW)),
                 replace(WAVES, semi_m=(7.0, 1e9)), long="the row above"),
        Scenario("water from 250 m is a poor fit or wide", over("water", LARGE), replace(WAVES, semi_m=(16.0, 1e9)),
                 long="from 100 m, above"),
        Scenario("the sea from 250 m is a poor fit or wide", over("sea", LARGE), replace(WAVES, semi_m=(16.0, 1e9)),
                 long="from 100 m, above"),
        Scenario("land under 35 m/s is solved", replace(LARGE, flight=FAST), SOLVED, long="at 20 m/s, above"),
        # The waves' own motion is a tenth of what is seen.
        Scenario("the sea under 35 m/s is answered with half as much radius again as land",
                 over("sea", replace(LARGE, flight=FAST)), Expected(reasons=(POOR_FIT, FEATURELESS)), radius=(1.5, 1e9),
                 radius_of=Scenario("land", replace(LARGE, flight=FAST), SOLVED), long="from 100 m, above"),
        # Rows that repeat exactly: rates and velocities since the last picture are better than half a row.
        Scenario("stripes are distinguished by telemetry", over("stripes"), SOLVED),
        Scenario("stripes in large pictures are distinguished by telemetry", over("stripes", LARGE), SOLVED,
                 long="the row above"),
        Scenario("crop rows 1.5 m apart from 100 m are solved", over("stripes", CROPS, row_spacing_m=1.5), IN_ROWS),
        Scenario("crop rows 1.5 m apart from 60 m are solved", over("stripes", LOW_CROPS, row_spacing_m=1.5), IN_ROWS,
                 long="from 100 m, above"),
        Scenario("rows 0.6 m apart from 100 m, finer than the prediction, are repetitive",
                 over("stripes", CROPS, row_spacing_m=0.6), refused(REPETITIVE)),
        # Answered, it was 140 to 340 m off.
        Scenario("stripes of which nothing specifies by how many rows they moved are repetitive",
                 over("stripes", replace(LARGE, rate_hz=1.0)), refused(REPETITIVE), config=(NO_ATTITUDE, LEVEL_GROUND),
                 long="finer rows, above"),
        Scenario("so they are at three pictures a second", over("stripes", replace(LARGE, rate_hz=3.0)),
                 refused(REPETITIVE), config=(NO_ATTITUDE, LEVEL_GROUND), long="the row above"),
        Scenario("crop rows that two pictures a second pass three at a time are repetitive",
                 over("stripes", replace(CROPS, rate_hz=2.0), row_spacing_m=1.5), refused(REPETITIVE),
                 long="finer rows, above"),
        Scenario("large pictures of level ground are solved", LARGE, SOLVED, long="small ones, above"),
        Scenario("lorries on 3 % of the ground cost no radius", over("traffic", LARGE, vehicle_spacing_m=128), SOLVED,
                 radius_of=Scenario("an empty road", LARGE, SOLVED), radius=(0.0, 1.2), long="on 5 %, below"),
        # 42 km/h, on a quarter of the tracks: they are outliers.
        Scenario("lorries on 5 % of the ground do not pull it along", over("traffic"), SOLVED),
        # With nearly all of the tracks: the scene moves with them.
        Scenario("a convoy on a fifth of the ground is not taken for it", over("traffic", LARGE, vehicle_spacing_m=16),
                 refused(POOR_FIT), long="lorries on 5 %, above"),
        Scenario("another convoy is not taken for the ground", over("traffic", LARGE, seed=7, vehicle_spacing_m=16),
                 refused(POOR_FIT), long="the row above"),
        Scenario("a tenth of the contrast is featureless or holds", replace(LEG, texture=TextureSpec(contrast=0.1)),
                 either(FEATURELESS, POOR_FIT), long="a plain, above, and a third, below"),
        Scenario("a third of the contrast is enough", replace(LEG, texture=TextureSpec(contrast=0.35)), SOLVED),
        Scenario("an exposure that hunts by 3.5 between pictures is solved",
                 replace(LEG, sensor=SensorSpec(exposure_swing=3.5)), SOLVED, long="a third of the contrast, above"),
        Scenario("a pixel of motion blur is solved", replace(LEG, sensor=SensorSpec(exposure_s=0.03)), SOLVED,
                 long="by more: test_degraded_pictures.py"),
        Scenario("three pixels of motion blur are solved", replace(LEG, sensor=SensorSpec(exposure_s=0.08)), SOLVED,
                 long="by more: test_degraded_pictures.py"),
        Scenario("pictures out of focus from first to last are refused, or their ellipses hold", LEG,
                 either(FEATURELESS, POOR_FIT, LOW_PARALLAX), spoilt=pictures(defocused),
                 long="two seconds of them, below, and a blur of 12 in test_degraded_pictures.py"),
        Scenario("two seconds of black pictures are featureless and pass", LEG, BLIND, spoilt=pictures(black, 9, 15)),
        Scenario("two seconds of white pictures are featureless and pass", LEG, BLIND, spoilt=pictures(white, 9, 15)),
        Scenario("two seconds out of focus are featureless or answered, and pass", LEG,
                 replace(BLIND, stretches=((0, 9, OK), (19, 24, OK))), spoilt=pictures(defocused, 9, 15)),
    ],
    # Motion that shows no depth, and mounts that look aside.
    "motion": [
        Scenario("a hover has low parallax", HOVER, refused(LOW_PARALLAX)),
        Scenario("a turn on the spot has low parallax", ROTATION, refused(LOW_PARALLAX)),
        # Wind and receiver move the position by a tenth of the height: it was `starting` again and again.
        Scenario("a low hover has low parallax and keeps it", LOW_HOVER,
                 Expected(refuses_clicks=True, settles=(LOW_PARALLAX, 10))),
        *(
            # What moves in the pictures is the ground and not the aircraft; waves that are off each other are
            # featureless, and it starts again in between.
            Scenario(f"waves of {style} under a hover are no depth", over(style, replace(LARGE, flight=HOVER.flight)),
                     refused(LOW_PARALLAX, POOR_FIT, FEATURELESS, starting=0.6),
                     long="a hover, above, and water from 100 m")
            for style in ("water", "sea")
        ),
        # But for the picture's rim outside the outermost rays.
        Scenario("a hover over known terrain is answered by it", HOVER, solved(median_m=5.0, methods={"terrain": 0.7}),
                 terrain=LevelTerrain()),
        # Features move, but a window has no parallax of its own: terrain gives its depths and not its tilt.
        Scenario("a turn on the spot over known terrain is answered by it", ROTATION,
                 solved(median_m=5.0, methods={"terrain": 0.7}), terrain=LevelTerrain(), long="the row above"),
        Scenario("a hover is answered from home's level where that is allowed, less surely than by terrain", HOVER,
                 solved(median_m=5.0, methods={"plane": 1.0}), config=(("solve.home_level", True),),
                 radius_of=OVER_TERRAIN, radius=(1.0, 1e9)),
        # Rotation about the path is seen by attitude and level ground alone.
        Scenario("an exactly straight path without any shake is solved", along(PathSpec("straight", wobble_deg=0.0)),
                 SOLVED, long="with a little shake: level ground, above"),
        *(
            Scenario(f"a mount of {'/'.join(f'{angle:.0f}' for angle in mount)} degrees is solved",
                     replace(LEG, mount_deg=mount, clicks_per_frame=8), solved(median_m=12.0),
                     long="" if mount[1] == -45.0 else "the first mount")
            for mount in MOUNTS_DEG
        ),
    ],
    # Telemetry that is thin, late, lost, or worse than declared.
    "telemetry": [
        Scenario("two messages a second of each kind are enough",
                 along(STRAIGHT, TelemetrySpec(position_hz=2.0, gps_hz=2.0, attitude_hz=2.0)), solved(0.8)),
        Scenario("a log without attitude is solved by travel, level ground and pictures, less surely than with it",
                 SILENT_ATTITUDE, solved(0.7, 15.0), config=(LEVEL_GROUND,),
                 radius_of=Scenario("with attitude", LEG, SOLVED, config=(LEVEL_GROUND,)), radius=(1.0, 1e9)),
        # Nothing shows roll: the pictures have sets, whose ellipses are too long.
        Scenario("without attitude over ground that may slope it is solved and too wide to answer", SILENT_ATTITUDE,
                 Expected(solved=(0.7, 1.0), may_refuse_all=True, refused_clicks={Status.UNCERTAIN: 0.9}),
                 long="the row above"),
        # A delay is a shift along the path.
        Scenario("declared stamps 0.3 s late widen and hold", replace(LEG, camera_delay_s=0.3), solved(median_m=10.0),
                 config=(("camera.sigma_latency_s", 0.3),), long="tests/test_platform_errors.py"),
        Scenario("three seconds without a fix are refused, and pass", replace(LEG, seconds=16.0, rate_hz=2.0),
                 Expected(stretches=((0, 9, OK), (12, 16, NO_GPS), (-6, None, OK))),
                 telemetry=without_fix(lambda t: 5.0 < t < 8.0)),
        *(
            # Sampled with the preset: 1, positions twice a second and 0.06 s ahead; 3, 0.07 s ahead and a compass up to
            # 2.6 degrees off; 8, a followed glitch of 21 m; 12, positions 0.22 s behind.
            Scenario(f"the errors of ordinary autopilot {seed} in {seconds:.0f} s are inside what is claimed",
                     ordinary_turns(seed, seconds), ORDINARY, long="recorded autopilots: test_recorded_autopilots.py")
            for seed, seconds in ((1, 30.0), (1, 45.0), (3, 45.0), (8, 45.0), (12, 45.0))
        ),
        *(
            Scenario(f"declared stamps cut to the second are answered with a radius that holds, survey {seed}",
                     photographs(seed), Expected(solved=(0.85, 1.0), median_m=5.0, semi_m=(0.0, 15.0)),
                     spoilt=cut_to_the_second, config=WHOLE_SECONDS, long="photographs: test_import_photos.py")
            for seed in (0, 1)
        ),
        *(
            Scenario(f"not declared, the same stamps are refused or wrong, survey {seed}", photographs(seed),
                     Expected(solved=(0.0, 0.79), inside_99=0.0), spoilt=cut_to_the_second,
                     long="shows that the row above can fail")
            for seed in (0, 1)
        ),
    ],
    # Pictures that come slowly, 0.1 to 13 s apart, with and without gaps of telemetry in between.
    "slow pictures": [
        *(
            Scenario(f"pictures {apart_s:g} s apart are solved", apart(apart_s, count), ANSWERS,
                     long="" if apart_s == 3.0 else "3 s apart")
            for apart_s, count in ((10.0, 12), (3.04, 12), (1.0, 14), (0.1, 120), (3.0, 12), (5.0, 12))
        ),
        Scenario("36 % of a picture in common is enough", apart(10.0, speed_m_s=20.0), ANSWERS,
                 long="with less: what is stated to be enough, test_slow_pictures.py"),
        # No velocity between them, but two positions.
        Scenario("telemetry that pauses for half of the time between pictures 4 s apart is no outage", apart(4.0),
                 ANSWERS, telemetry=silence(between(4.0, 0.2, 0.7))),
        Scenario("telemetry that pauses for half of the time between pictures 10 s apart is no outage", apart(10.0),
                 ANSWERS, telemetry=silence(between(10.0, 0.2, 0.7)), long="4 s apart, above"),
        # Telemetry pauses over every third picture.
        Scenario("pictures slow by being refused go on when they are back", apart(5.0, 15),
                 Expected(counts={UNSYNCHRONISED: (5, 5), OK: (10, 10)}),
                 telemetry=silence(lambda t: 8.0 < t % 15.0 < 12.0)),
        # No window may hold two of them.
        Scenario("a fix lost between any two pictures is an outage", apart(10.0),
                 unsolved("GPS was lost or doubted between 11 of 11 pairs"),
                 telemetry=without_fix(lambda t: 2.0 < t % 10.0 < 3.5), long="three seconds without a fix, above"),
        Scenario("pictures 13 s apart are too far, though slow enough to see the same ground",
                 apart(13.0, speed_m_s=6.0), unsolved("pictures 13.0 s apart, at most 12.0; take"),
                 long="without overlap, test_slow_pictures.py"),
        # 20 m/s: the picture that shows nothing leaves the next without overlap, and it begins again.
        Scenario("one missed picture costs no more than itself", apart(10.0, 16, speed_m_s=20.0),
                 Expected(counts={OK: (14, MANY)}), spoilt=pictures(black, 7, 8), long="blind pictures, above"),
        Scenario("a hover that solves nothing has no parallax for a reason", replace(apart(1.0), flight=HOVER.flight),
                 unsolved("no parallax: ")),
        Scenario("telemetry that ends before the pictures is a gap", apart(1.0), unsolved("telemetry gap: "),
                 telemetry=silence(lambda t: t > -3.0)),
        Scenario("a receiver without any fix is a reason", apart(1.0), unsolved("no accepted position"),
                 telemetry=without_fix(lambda t: True)),
        Scenario("two seconds are too short", apart(0.1, 20), unsolved("too short: ")),
    ],
    # Bland ground, a strong fixed pattern, a shutter event; places as honest as any others.
    "thermal": [
        # The shutter's pictures are bad and no others; it goes on within two seconds of the jump.
        Scenario("a Lepton flies through its fixed pattern and a shutter event", LEPTON,
                 Expected(solved=(0.8, 0.98), counts={BAD_PICTURE: (4, 4), FEATURELESS: (0, 3)},
                          stretches=((56, 60, BAD_PICTURE),), ok_from=(76, 0.9)),
                 long="tests/onboard/camera/test_thermal_grey.py"),
        Scenario("without the counts the same flight is lost in the pattern", LEPTON,
                 Expected(solved=(0.0, 0.59), inside_99=0.0), config=(("thermal.enabled", False),),
                 long="shows that the row above can fail"),
    ],
}  # fmt: skip


@pytest.mark.parametrize("row", as_parameters(TABLE))
def test_scenario(row: Scenario) -> None:
    row.check()


def test_no_claim_stands_twice_in_the_table() -> None:
    claims = [row.claim for rows in TABLE.values() for row in rows]
    assert len(set(claims)) == len(claims) > 70
