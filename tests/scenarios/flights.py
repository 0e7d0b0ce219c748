"""A scenario: one small simulated flight through the whole onboard pipeline, every true click asked of the ground.

Pictures are small and few, so that all scenarios together take a minute or two; each flight is simulated once a test
run.
"""

import csv
import shutil
import tomllib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.answer import Fix
from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.pipeline.terrain_at_hand import TerrainSource
from onboard.replay.runner import Flight, replay
from onboard.vision.contrast_normalisation import Picture
from simulation.session import SessionSpec, fly
from tests.flights_folder import kept
from tests.set_sink import SetSink

Array = NDArray[np.float64]

CAMERA = Camera.from_field_of_view(320, 240, 40.0)
CHI2_90, CHI2_99 = 4.6052, 9.2103  # two degrees of freedom


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a flight: the last set of each picture, and every true click."""

    sets: dict[int, FeatureSet]
    refusals: Counter[Status]  # of clicks
    methods: Counter[str]
    errors_m: Array
    chi2: Array  # squared normalised horizontal errors of answered clicks
    semi_m: Array
    pipeline: Pipeline | None

    @property
    def statuses(self) -> Counter[Status]:
        return Counter(s.status for s in self.sets.values())

    @property
    def solved(self) -> float:
        """Share of pictures that answer."""
        return self.statuses[Status.OK] / max(len(self.sets), 1)

    @property
    def inside_99(self) -> float:
        """Share of answered clicks whose truth lies inside the 99 % ellipse; the test fails where none was answered."""
        assert len(self.chi2), f"nothing was answered: {self.reported}"
        return float(np.mean(self.chi2 < CHI2_99))

    def is_honest(self, share: float = 0.97) -> bool:
        """Whether so many answered clicks lie inside, for scenes in which all may rightly be refused."""
        return not len(self.chi2) or self.inside_99 >= share

    @property
    def reported(self) -> str:
        """One line for a failed assertion."""
        answered = f"answered {len(self.errors_m)}"
        if len(self.errors_m):
            answered += (
                f", error median {np.median(self.errors_m):.2f} max {self.errors_m.max():.2f} m, "
                f"semi-major {np.median(self.semi_m):.2f} m, inside 99 %: {self.inside_99:.3f}"
            )
        return f"pictures {_words(self.statuses)}; refused clicks {_words(self.refusals)}; {answered}"


class _Sets(SetSink):
    def __init__(self) -> None:
        self.by_frame: dict[int, FeatureSet] = {}

    def feature_set(self, output: FeatureSet) -> None:
        self.by_frame[output.frame] = output


_COPIES = TemporaryDirectory(prefix="scenarios-")


@cache
def simulated(spec: SessionSpec) -> Path:
    """The session's folder, not to be written to; a spec is simulated once in a run, whichever worker needs it."""
    return kept(sha256(repr(spec).encode()).hexdigest()[:16], lambda folder: fly(spec, folder))


def copied(folder: Path) -> Path:
    """A copy of a session, to be changed."""
    return Path(shutil.copytree(folder, mkdtemp(dir=_COPIES.name), dirs_exist_ok=True))


def retouched(folder: Path, change: Callable[[Picture], Picture], frames: range | None = None) -> Path:
    """A copy of a session with some pictures changed, all if `frames` is None."""
    copy = copied(folder)
    files = sorted((copy / "frames").iterdir())
    for index in range(len(files)) if frames is None else frames:
        image = np.asarray(cv2.imread(str(files[index]), cv2.IMREAD_GRAYSCALE), np.uint8)
        assert cv2.imwrite(str(files[index]), change(image))
    return copy


def play(
    folder: Path,
    *overrides: tuple[str, object],
    terrain: TerrainSource | None = None,
    spoil: Callable[[Event, float], Event | None] | None = None,
) -> Outcome:
    """Replay a session under its configuration with `overrides` ("section.key", value), and click.

    `spoil` may change each telemetry event, given its time (s) since the first picture, or lose it (None).
    """
    table = tomllib.loads((folder / "config.toml").read_text())
    for name, value in overrides:
        section, key = name.split(".")
        table.setdefault(section, {})[key] = value
    config = Config.model_validate(table)
    camera = replace(Camera.from_json(folder / "camera.json"))  # taken as it is: `replace` leaves its sigmas out
    flight = Flight.open(config, camera, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    if spoil is not None:
        first_ns, log = flight.frames.stamps_ns[0], flight.telemetry
        spoilt = ((t, spoil(e, (e.stamp_ns - first_ns) / 1e9)) for t, e in zip(log.arrival_ns, log.events, strict=True))
        kept = [(t, e) for t, e in spoilt if e is not None and not isinstance(e, Frame)]
        log = replace(log, arrival_ns=[t for t, _ in kept], events=[e for _, e in kept])
        flight = replace(flight, telemetry=log)
    pipeline, sink = Pipeline(config, camera, terrain), _Sets()
    replay(flight, pipeline, [sink])
    return click(folder, sink.by_frame, pipeline)


def click(folder: Path, sets: dict[int, FeatureSet], pipeline: Pipeline | None) -> Outcome:
    """Ask every true click on these pictures' sets."""
    refusals: Counter[Status] = Counter()
    methods: Counter[str] = Counter()
    errors, chi2, semi = [], [], []
    locators: dict[int, Locator] = {}
    with (folder / "truth_clicks.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            frame = int(row["frame"])
            if frame not in sets:
                continue
            if frame not in locators:
                locators[frame] = Locator(sets[frame])
            answer = locators[frame].locate((float(row["u"]), float(row["v"])))
            if not isinstance(answer, Fix):
                refusals[answer.status] += 1
                continue
            place = LocalFrame(float(row["lat_deg"]), float(row["lon_deg"]), float(row["height_amsl_m"]))
            assert answer.height_amsl_m is not None
            error = place.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m)[:2]
            methods[answer.method] += 1
            errors.append(float(np.hypot(*error)))
            chi2.append(float(error @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error)))
            semi.append(answer.ellipse.semi_major_m)
    return Outcome(sets, refusals, methods, np.array(errors), np.array(chi2), np.array(semi), pipeline)


def _words(counted: Counter[Status]) -> dict[str, int]:
    return {status.value: count for status, count in counted.most_common()}
