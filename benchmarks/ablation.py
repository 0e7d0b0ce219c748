"""What each mechanism of the estimator buys: every one off in turn, on the flights it exists for and on ordinary ones.

    python -m benchmarks.ablation [--mechanisms "row waves,zoom"] [--draws 6] [--again 10] [--flights "own,ordinary"]

Recorded telemetry of real autopilot software over simulated ground and simulated flights; features are points of the
ground with pixel noise, so nothing is rendered and nothing tracked. A mechanism is switched off from here
(`mechanisms`): the product has no such switch. A draw's seed gives the same telemetry, ground and noise with and
without it, so the two are compared draw by draw. Printed for every mechanism and flight: with everything on, the means
over the draws of the share of clicks answered, of the median and the 90 % error (m), of the share inside the 90 %
ellipse, of sharpness (`click_score`) and of the worst error over its own ellipse; then what switching the mechanism off
changes, as the mean of the paired differences and its standard error (errors in per cent of what they are with
everything on, shares in points). Then, for each mechanism, what is worse and what is better without it beyond the 95 %
interval of its draws (Student's t). Where nothing is worse, all that once more with more draws of its own flights.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from benchmarks.ablation_scenes import ORDINARY, ORDINARY_SECONDS, Trial, own
from benchmarks.click_score import Score, clicks, scored
from benchmarks.machine import describe
from benchmarks.mechanisms import MECHANISMS, Mechanism
from benchmarks.sampled_flight import every_set
from benchmarks.scatter import mean_and_sigma

Array = NDArray[np.float64]

CLICKS = 4
FIGURES = ("answered", "median", "90 %", "inside", "sharpness", "worst")
COLUMNS = ("answered", "median m", "90 % m", "inside", "sharpness", "worst")
UNITS = (" points", " %", " %", " points", "", "")
# Of a draw that answers nothing: a refusal is not wrong, and what is answered in its place may be.
REFUSED = np.array([0.0, np.nan, np.nan, 0.9, 1.0, np.nan])

LEGEND = """\
First the means with everything on, then what switching off changes: mean and standard error of the paired differences,
shares in points, errors in per cent, of the draws that answer without it (errors: and with it); nan of fewer than two.
A draw that answers only without it is compared with 90 % inside and sharpness 1."""


def fly(trial: Trial, seed: int) -> Score:
    """One flight through the pipeline, and its clicks."""
    flight = trial.flight(seed)
    pipeline = trial.pipeline(flight)
    sets = {out.frame: out for out in every_set(pipeline, flight.events())}
    score = scored(flight, clicks(flight, sets, flight.spec.camera.size_px, CLICKS, trial.warm_s, seed))
    spent = pipeline.summary.stage_seconds
    score.processor_s = sum(seconds for stage, seconds in spent.items() if stage != "tracking")
    return score


def figures(score: Score) -> Array:
    """One draw's `FIGURES` (6,); nan where nothing was answered."""
    answered = score.answered["all"] / max(score.asked["all"], 1)
    if not score.error_m:
        return np.array([answered, *[np.nan] * 5])
    median, ninth = np.quantile(score.error_m, [0.5, 0.9])
    ratio = np.array(score.ratio)
    return np.array([answered, median, ninth, np.mean(ratio < 1.0), np.quantile(ratio, 0.9), ratio.max()])


def simulated(
    trial: Trial, draws: int, how: AbstractContextManager[None], scores: list[Score] | None = None
) -> tuple[Array, float]:
    """Figures (N, 6) of some draws of a flight, and the estimator's mean processor time (s).

    `scores`: of the first draws, if they have been simulated before; those that were not are appended.
    """
    scores = [] if scores is None else scores
    with how:
        scores += [fly(trial, trial.seed + draw) for draw in range(len(scores), draws)]
    used = scores[:draws]
    return np.stack([figures(score) for score in used]), float(np.mean([score.processor_s for score in used]))


def differences(on: Array, off: Array) -> Array:
    """(N, 6) what switching off changes in each draw: shares in points, errors in per cent of their mean."""
    scale = np.array([0.01, *means(on)[1:3] / 100.0, 0.01, 1.0, 1.0])
    out: Array = (off - refused_as_right(on)) / scale
    return out


def means(on: Array) -> Array:
    """(6,) of figures (N, 6): all but the first of draws that answer anything."""
    answering = on[np.isfinite(on[:, 1]), 1:]
    return np.append(on[:, 0].mean(), answering.mean(axis=0) if len(answering) else np.full(5, np.nan))


def refused_as_right(on: Array) -> Array:
    """Figures (N, 6), those of draws that answer nothing as `REFUSED`."""
    return np.where(np.isfinite(on[:, 1:2]), on, REFUSED)


def of_known(changes: Array) -> tuple[float, float]:
    """Mean and standard error of changes (N,), nan in draws that have none."""
    known = changes[np.isfinite(changes)]
    return mean_and_sigma(known) if len(known) > 1 else (float("nan"), float("nan"))


def _judged(f: Array) -> Array:
    """(N, 6) how bad figures (N, 6) are: coverage and sharpness by how far from right, whichever way."""
    off_right = np.abs(np.log2(np.maximum(f[:, 4], 1e-3)))
    return np.stack([-f[:, 0], f[:, 1], f[:, 2], np.abs(f[:, 3] - 0.9), off_right, f[:, 5]], axis=1)


def change(name: str, on: Array, off: Array) -> tuple[list[str], list[str]]:
    """The figures that are worse without a mechanism on a flight, and those that are better, beyond the interval of the
    draws, in words.
    """
    worse: list[str] = []
    better: list[str] = []
    judged, steps = _judged(off) - _judged(refused_as_right(on)), differences(on, off)
    for figure, unit, bad, step in zip(FIGURES, UNITS, judged.T, steps.T, strict=True):
        known = bad[np.isfinite(bad)]
        if len(known) < 2:
            continue
        mean, error = mean_and_sigma(known)
        if abs(mean) > max(float(student.ppf(0.975, len(known) - 1)) * error, 1e-9):
            changed, least = of_known(step)
            text = f"{name}: {figure} {changed:+.2g} ± {least:.1g}{unit}"
            (worse if mean > 0.0 else better).append(text)
    return worse, better


def row(name: str, flight: str, on: tuple[Array, float], off: tuple[Array, float]) -> str:
    """A row of the table."""
    answered, median, ninth, inside, sharpness, worst = means(on[0])
    steps = differences(on[0], off[0])
    changes = ["{:+.1f} ± {:.1f}".format(*of_known(step)) for step in steps[:, :4].T]
    changes += ["{:+.2f} ± {:.2f}".format(*of_known(step)) for step in steps[:, 4:].T]
    on_text = f"{100 * answered:.0f} % | {median:.2f} | {ninth:.2f} | {100 * inside:.0f} % | {sharpness:.2f}"
    return f"| {name} | {flight} | {on_text} | {worst:.1f} | {' | '.join(changes)} | {on[1]:.1f} -> {off[1]:.1f} |"


def compared(
    mechanism: Mechanism, trials: Sequence[Trial], draws: int, known: dict[tuple[str, str], list[Score]]
) -> tuple[list[str], list[str]]:
    """Print a mechanism's rows; what is worse without it, and what is better, in words.

    `known`: what has been simulated, by the mechanism that was off ("": none) and the flight.
    """
    worse: list[str] = []
    better: list[str] = []
    for trial in trials:
        on = simulated(trial, draws, nullcontext(), known.setdefault(("", trial.name), []))
        off = simulated(trial, draws, mechanism.off(), known.setdefault((mechanism.name, trial.name), []))
        print(row(mechanism.name, trial.name, on, off), flush=True)
        more_worse, more_better = change(trial.name, on[0], off[0])
        worse += more_worse
        better += more_better
    return worse, better


def table(
    mechanisms: Sequence[Mechanism],
    trials: Mapping[str, Sequence[Trial]],
    draws: int,
    known: dict[tuple[str, str], list[Score]],
) -> list[Mechanism]:
    """Print the rows of some mechanisms, by name on these flights, and what they show; those that show nothing."""
    columns = " | ".join([*COLUMNS, *(f"change of {f}" for f in FIGURES)])
    print(f"| mechanism off | flight | {columns} | processor s |\n|---|---|{'---:|' * 13}", flush=True)
    verdicts = [compared(m, trials[m.name], draws, known) for m in mechanisms]
    print("\n| mechanism | off means | worse without it | better without it |\n|---|---|---|---|")
    for m, (worse, better) in zip(mechanisms, verdicts, strict=True):
        print(f"| {m.name} | {m.neutral} | {'; '.join(worse) or 'nothing'} | {'; '.join(better) or 'nothing'} |")
    return [m for m, (worse, _) in zip(mechanisms, verdicts, strict=True) if not worse]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mechanisms", default=",".join(m.name for m in MECHANISMS))
    parser.add_argument("--draws", type=int, default=4, help="of every flight; at least two")
    parser.add_argument("--again", type=int, default=10, help="draws where those show nothing; 0: not again")
    parser.add_argument("--flights", default="own,ordinary", help="own, ordinary, or both")
    args = parser.parse_args()
    if args.draws < 2:
        parser.error("--draws: at least two, or nothing shows their scatter")
    asked, kinds = args.mechanisms.split(","), args.flights.split(",")
    by_mechanism, began = own(), time.process_time()
    print(f"{describe()}\n")
    print(f"{args.draws} draws; ordinary: {'; '.join(t.name for t in ORDINARY)}; {ORDINARY_SECONDS:.0f} s each.\n")
    print(f"{LEGEND}\n")
    chosen = sorted((m for m in MECHANISMS if m.name in asked), key=lambda m: asked.index(m.name))
    ordinary = ORDINARY if "ordinary" in kinds else ()
    own_of = {m.name: by_mechanism[m.name] if "own" in kinds else () for m in chosen}
    known: dict[tuple[str, str], list[Score]] = {}
    idle = table(chosen, {name: trials + ordinary for name, trials in own_of.items()}, args.draws, known)
    if idle and args.again > args.draws and "own" in kinds:
        print(f"\nThose that show nothing, on the flights that they exist for, {args.again} draws.\n")
        idle = table(idle, own_of, args.again, known)
    shown = ", ".join(m.name for m in idle) or "none"
    print(f"\nShows nothing: {shown}. Processor time of all: {time.process_time() - began:.0f} s")


if __name__ == "__main__":
    main()
