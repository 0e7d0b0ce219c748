"""`python -m benchmarks`: every benchmark, one after the other, into benchmarks/results.md.

    python -m benchmarks [--only NAME ...] [--quick] [--out benchmarks/results.md]

Each runs as a process of its own, so that none is affected by another's memory or threads. With `--only`, sections of
other benchmarks stay in the file as they are. Exit code 1 if one could not be measured; the file then states which and
why.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.autopilots import STARTS
from benchmarks.machine import describe

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results.md"
TIMEOUT_S = 14400.0  # of one benchmark: the longest, the ablation, takes two and a half hours on a busy machine

RECORDED = ("--recordings", ",".join(STARTS), "--seconds", "240", "--seed", "3")
CODECS = ("--seconds", "12", "--seeds", "1,2")
QUICK_CODECS = ("--seconds", "12", "--seeds", "1", "--autopilots", "2", "--kbit", "500")


@dataclass(frozen=True)
class Benchmark:
    """One of our programs: what it answers, and its arguments in full and in a hurry."""

    module: str
    title: str
    full: tuple[str, ...] = ()
    quick: tuple[str, ...] = ()


BENCHMARKS = (
    Benchmark("accuracy", "Errors over the Cramer-Rao bound", (), ("--flights", "10")),
    Benchmark("coverage", "Honesty of the stated radius"),
    Benchmark("beyond", "Clicks beyond the features", (), ("--flights", "1")),
    Benchmark(
        "autopilots",
        "With recorded autopilots",
        (*RECORDED, "--draws", "5"),
        ("--recordings", "plane_clean", "--seconds", "40"),
    ),
    Benchmark(
        "autopilots",
        "With recorded autopilots over hills",
        (*RECORDED, "--draws", "4", "--faults", "hills"),
        ("--recordings", "plane_clean", "--seconds", "40", "--faults", "hills"),
    ),
    Benchmark(
        "autopilots",
        "With recorded autopilots over steep ground",
        (*RECORDED[:3], "120", "--seed", "3", "--draws", "3", "--sensors", "gps", "--faults", "rough,hill country"),
        ("--recordings", "plane_clean", "--seconds", "40", "--sensors", "gps", "--faults", "rough"),
    ),
    Benchmark(
        "ablation",
        "What each mechanism buys",
        (),
        ("--mechanisms", "row waves", "--draws", "2", "--again", "0", "--flights", "own"),
    ),
    Benchmark(
        "rolling_shutter",
        "Rows read one after the other",
        ("--flights", "16"),
        ("--flights", "1", "--seconds", "75", "--sensors", "full", "--told", "global shutter,0 to 20 ms"),
    ),
    Benchmark(
        "fisheye",
        "Through a fisheye",
        ("--flights", "3", "--off", "0.03"),
        ("--flights", "1", "--seconds", "8", "--lenses", "60,150", "--off", "0.03"),
    ),
    Benchmark("bundle", "The window solve against GTSAM", (), ("--repeat", "5")),
    Benchmark("tracking", "A tracking step against raw Lucas-Kanade", (), ("--seconds", "3", "--passes", "1")),
    Benchmark("tracks", "Things that move", ("--flights", "3"), ("--scenes", "hover")),
    Benchmark("manoeuvres", "Things that brake, turn and stop", (), ("--scenes", "hover", "--flights", "1")),
    Benchmark("thermal_tracking", "Poses from thermal pictures", (), ("--rows", "300 mK", "--seconds", "8")),
    Benchmark("spots", "Hot spots", (), ("--scenes", "calm", "--flights", "1", "--pictures", "60")),
    Benchmark(
        "found_coverage",
        "Ellipses of spots and tracks",
        ("--flights", "20"),
        ("--flights", "1", "--rows", "straight down"),
    ),
    Benchmark("pipeline", "The pipeline at thirty pictures a second", ("--hour", "--profile"), ("--minutes", "1")),
    Benchmark("against", "Processor time against an earlier commit", (), ("--turns", "4")),
    Benchmark("latency", "From exposure to an answer on the ground", (), ("--seconds", "20")),
    Benchmark("budget", "What a picture costs", ("--instructions",), ("--pictures", "60", "--sizes", "640x480")),
    Benchmark("soak", "An hour in the daemon", ("--minutes", "30"), ("--minutes", "2")),
    Benchmark("wire", "A set on the wire", (), ("--repeat", "20")),
    Benchmark("click", "A click", (), ("--sets", "500", "--clicks", "500", "--runs", "3")),
    Benchmark("measured_clicks", "Clicks measured by themselves", (), ("--scenes", "down-none", "--clicks", "30")),
    Benchmark("web", "The page", (), ("--clicks", "100", "--pictures", "600")),
    Benchmark("seen", "What has been seen", ("--flights", "2"), ("--rows", "flat, straight")),
    Benchmark("detection", "Who would have been found", (), ("--flights", "2")),
    Benchmark("fleet", "Many aircraft at one router", (), ("--aircraft", "10", "--operators", "5", "--seconds", "8")),
    Benchmark("radio", "Clicks through an autopilot's radio"),
    Benchmark("look_there", "Looking there and circling, with a real autopilot"),
    Benchmark("link", "What the link adds", (), ("--seconds", "1")),
    Benchmark(
        "picture_loss",
        "Pictures over a lossy radio",
        ("--pictures", "200", "--kinds", "udp"),
        ("--pictures", "20", "--kinds", "udp", "--sizes", "6000"),
    ),
    Benchmark("picture_size", "What a small picture takes", (), ("--most", "2")),
    Benchmark("recording", "What recording costs", (), ("--seconds", "5")),
    Benchmark(
        "sources",
        "Pictures from a network stream",
        (),
        ("--seconds", "10", "--streams", "1000:0.15", "--seeds", "2"),
    ),
    Benchmark("sources", "Stamps of cameras that are devices", ("--devices",), ("--devices",)),
    Benchmark(
        "source_codecs",
        "What compression costs",
        ("--size", "1280x720", *CODECS, "--autopilots", "8", "--kbit", "1000,2000,4000,8000"),
        ("--size", "320x240", *QUICK_CODECS),
    ),
    Benchmark(
        "source_codecs",
        "What compression costs at 1080p",
        ("--size", "1920x1080", *CODECS, "--autopilots", "4", "--kbit", "1000,2000,4000,8000"),
        ("--size", "640x480", *QUICK_CODECS),
    ),
    Benchmark(
        "source_codecs",
        "What compression costs with H.265",
        ("--size", "1280x720", *CODECS, "--autopilots", "5", "--codecs", "H265", "--kbit", "1000,4000"),
        ("--size", "320x240", *QUICK_CODECS, "--codecs", "H265"),
    ),
    Benchmark(
        "source_codecs",
        "What compression costs where packets are lost",
        ("--seconds", "24", "--seeds", "2", "--autopilots", "5", "--kbit", "2000", "--loss", "0.01"),
        ("--size", "320x240", *QUICK_CODECS, "--loss", "0.01"),
    ),
    Benchmark(
        "foreign_clock",
        "A foreign camera's clock by positions alone",
        (),
        ("--flights", "1", "--kinds", "turns", "--rates", "1"),
    ),
    Benchmark("real_flight", "The real flight"),
)
# Programs of this folder that a benchmark starts.
STARTED = {"flight_in_turns": "against", "latency_daemon": "latency", "soak_daemon": "soak", "fleet_side": "fleet"}


def measured(benchmark: Benchmark, quick: bool) -> tuple[str, bool]:
    """The section of one benchmark, and whether it could be measured."""
    arguments = benchmark.quick if quick else benchmark.full
    command = [sys.executable, "-m", f"benchmarks.{benchmark.module}", *arguments]
    began = time.monotonic()
    with tempfile.TemporaryFile("w+") as printed:  # not a pipe: what a program printed before it was ended is kept
        try:
            done = subprocess.run(
                command,
                cwd=HERE.parent,
                stdout=printed,
                stderr=subprocess.PIPE,
                text=True,
                check=False,
                timeout=TIMEOUT_S,
                env={**one_thread(), "PYTHONUNBUFFERED": "1"},
            )
            is_good, why = done.returncode == 0, (done.stderr.strip().splitlines() or ["?"])[-1]
        except subprocess.TimeoutExpired:
            is_good, why = False, f"not done after {TIMEOUT_S:.0f} s, what it had printed follows"
        printed.seek(0)
        output = printed.read().strip()
    took_s = time.monotonic() - began
    if not is_good:
        output = f"NOT measured: {why}\n\n{output}".rstrip()
    ran = f"`python -m {' '.join(command[2:])}`, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, {took_s:.0f} s; {commit()}"
    return section(benchmark, ran, output), is_good


def commit() -> str:
    """The commit that is measured, and whether files differ from it."""
    asked = ["git", "describe", "--always", "--dirty", "--abbrev=7", "--exclude", "*"]
    try:
        done = subprocess.run(asked, cwd=HERE, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "of no known commit"
    return done.stdout.strip()


def one_thread() -> dict[str, str]:
    """The environment of a benchmark that does not see to its threads itself."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
    return {**os.environ, **dict.fromkeys(names, "1")}


def section(benchmark: Benchmark, ran: str, said: str) -> str:
    """Markdown: what a program printed, tables of its own kept as tables."""
    parts = []
    said = said.replace(f"{HERE.parent}/", "")  # results name no folder of the machine
    for block in re.split(r"\n{2,}", said):
        is_table = block.lstrip().startswith("|")
        parts.append(block if is_table else f"```\n{block}\n```")
    return f"## {benchmark.title}\n\n{ran}\n\n" + "\n\n".join(parts) + "\n"


def merge(old: str, new: dict[str, str]) -> str:
    """The file: sections by title, new ones in place of old, in the order of BENCHMARKS, and nothing else."""
    held = {part.split("\n", 1)[0]: f"## {part}" for part in re.split(r"(?m)^## ", old)[1:]}
    sections = {**held, **new}
    head = (
        "# Measured\n\nWritten by `make bench`; each section names its machine and commit. Processor time unless it\n"
        "says otherwise; what is compared is run in turn in one process, and medians are shown. Every benchmark has a\n"
        "section; one alone: `python -m benchmarks --only NAME`. What changes did, before and after, is in\n"
        "[comparisons.md](comparisons.md). By hand, with other arguments than `make bench` gives:\n"
        "`python -m benchmarks.soak --minutes 60`, `benchmarks.accuracy --flights 1000`,\n"
        "`benchmarks.autopilots --faults ... --mounts ...`, `benchmarks.picture_size FOLDER`.\n"
    )
    ordered = [b.title for b in BENCHMARKS if b.title in sections]
    return "\n".join([head, *(sections[t].rstrip() + "\n" for t in ordered)])


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code: 0 everything measured, 1 something not."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__.splitlines()[0])
    names = [b.module for b in BENCHMARKS]
    parser.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=", ".join(names))
    parser.add_argument("--quick", action="store_true", help="small inputs: everything runs, little is measured")
    parser.add_argument("--out", type=Path, default=RESULTS)
    args = parser.parse_args(argv)
    print(describe())
    failed = []
    for benchmark in BENCHMARKS:
        if args.only and benchmark.module not in args.only:
            continue
        print(f"\n{benchmark.title} ...", flush=True)
        text, is_good = measured(benchmark, args.quick)
        print(text.split("\n\n", 1)[1])
        if not is_good:
            failed.append(benchmark.module)
        # After each, so that a long run broken off leaves what it had.
        old = args.out.read_text(encoding="utf-8") if args.out.exists() else ""
        args.out.write_text(merge(old, {benchmark.title: text}), encoding="utf-8")
    if failed:
        print(f"not measured: {', '.join(failed)}", file=sys.stderr)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
