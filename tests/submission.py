"""The choice of what a submission runs next to `make test`, by what changed; it reports what it leaves out, and why.

Of the long tests one third, which the number of commits names, and every one of a package that changed. The bench and
the other architecture where something changed that they alone try. Changed is what differs by the last 30 commits, or
by those of the last day if they are more, but by none before the newest tag: a release is tried whole. Without that
history (a shallow clone), everything runs.

    python -m tests.submission          print the choice
    python -m tests.submission bench    exit with 0 if the bench is chosen, else with 1; so too `arm64`
"""

import math
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VARIABLE = "POINTCLICK_LONG"
"""The environment's variable that asks a run of pytest for the choice of long tests: `chosen`; without it all run."""

THIRDS = 3
COMMITS = 30
AGE = "1 day ago"
CHANGED_BEGIN_WITHIN_S = 900.0
"""Long tests that are chosen for a change alone begin within this time of the run's start, or are left out by name.

By hand the third has no such bound.
"""
BEGAN_VARIABLE = "POINTCLICK_SUBMISSION_BEGAN"
"""The environment's variable with the time (s, POSIX) at which .ci/run began: then all begin as its end allows."""
SUBMISSION_S = 1800.0
"""The time that a submission may take from its beginning to its end, s."""
PART_S = {"bench": 420.0, "arm64": 330.0}
"""The time that is kept for what runs after the long tests, s."""
LAST_LONG_S = 120.0
"""The time that is kept for the long tests that are still running when the last may begin, s."""
LEAST_LONG_S = 240.0
"""The time that the long tests have in any case, s: on a slow machine the submission ends later."""

REAL_MACHINES = (
    "packaging", "onboard/camera", "onboard/service", "onboard/link", "systemd", "requirements.lock", "pyproject.toml",
)  # fmt: skip
"""Paths that the bench (a kernel's camera, a systemd) or the Debian packages on another architecture try."""
CHOSEN_BY: dict[str, tuple[str, ...]] = {
    "bench": (*REAL_MACHINES, "tests/bench"),
    "arm64": (*REAL_MACHINES, "tests/arm64", "tests/bench/image"),
}

EVERY_FLIGHT = (
    "contract", "onboard/estimation", "onboard/events", "onboard/geometry", "onboard/georeferencing",
    "onboard/navigation", "onboard/pipeline", "onboard/vision", "simulation",
)  # fmt: skip
"""Packages that every rendered or sampled flight goes through."""
RUNS = (
    "Makefile", "pyproject.toml", "tests/conftest.py", "tests/limits.py", "tests/long_tests.py", "tests/submission.py",
)  # fmt: skip
"""Files that state how tests are run: what tries them is the same for every change of anything else."""
INSTALLED = ("packaging", "requirements.lock", "pyproject.toml", "Makefile", "tests/installed.py")
PROGRAMS = (*EVERY_FLIGHT, "onboard/replay", "onboard/service", "onboard/storage", "onboard/link", "ground")
TRIES: dict[str, tuple[str, ...]] = {
    "tests/fuzz": ("contract", "ground", "onboard"),
    "tests/scenarios": EVERY_FLIGHT,
    "tests/web/test_docs_site.py": ("docs", "packaging", "README.md"),
    "tests/web": ("ground", "frontend"),
    "tests/test_benchmarks.py": ("benchmarks",),
    "tests/test_coverage.py": (*EVERY_FLIGHT, "benchmarks"),
    "tests/test_end_to_end.py": PROGRAMS,
    "tests/test_install.py": INSTALLED,
    "tests/test_learning.py": EVERY_FLIGHT,
    "tests/test_limits.py": RUNS,
    "tests/test_lock.py": INSTALLED,
    "tests/test_makefile.py": (*RUNS, "tests/costly_first.py"),
    "tests/test_packaging.py": INSTALLED,
    "tests/test_platform_errors.py": EVERY_FLIGHT,
    "tests/test_soak.py": PROGRAMS,
    "tests/test_submission.py": RUNS,
}
"""Paths that a folder or a file of tests tries which does not mirror a package; `tests/PACKAGE` tries PACKAGE."""


@dataclass(frozen=True)
class History:
    """The number of a checkout's commits, the paths that changed of late, and in words since when."""

    count: int
    changed: frozenset[str]
    since: str


def history(root: Path = ROOT) -> History | None:
    """Read the history of a checkout by git; None where it is not to be had, or too short."""
    if _git(root, "rev-parse", "--is-shallow-repository") != "false":
        return None
    count = int(_git(root, "rev-list", "--count", "HEAD") or 0)
    recent = int(_git(root, "rev-list", "--count", f"--since={AGE}", "HEAD") or 0)
    back = max(COMMITS, recent)
    base, since = _git(root, "rev-list", "--first-parent", f"--skip={back}", "--max-count=1", "HEAD"), f"{back} commits"
    tag = _git(root, "describe", "--tags", "--abbrev=0")
    if tag and int(_git(root, "rev-list", "--count", f"{tag}..HEAD") or 0) < back:
        base, since = tag, f"since {tag}"
    if not base:
        return None
    paths = _git(root, "diff", "--name-only", "--no-renames", base)
    return None if paths is None else History(count, frozenset(paths.splitlines()), since)


def _git(root: Path, *words: str) -> str | None:
    """Return what git prints, or None if it fails or is not there."""
    try:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def is_within(path: str, folders: Iterable[str]) -> bool:
    """Return whether a path is one of some files or folders, or lies in one."""
    return any(path == folder or path.startswith(f"{folder}/") for folder in folders)


def tried_by(file: str) -> tuple[str, ...]:
    """Return the paths whose change asks for a file of tests: itself, its helpers, and what it tries."""
    folder = file.rpartition("/")[0]
    for tests, paths in TRIES.items():
        if is_within(file, (tests,)):
            return paths
    return () if folder == "tests" else (folder.removeprefix("tests/"),)


@dataclass(frozen=True)
class Choice:
    """The choice of what a submission runs. `history` None: everything."""

    history: History | None

    @property
    def third(self) -> int | None:
        """The number of the third of the long tests that every submission of so many commits runs."""
        return None if self.history is None else self.history.count % THIRDS

    def is_in_third(self, test: str) -> bool:
        """Return whether a long test is of the third, by a hash of its name that is the same everywhere."""
        return self.third is None or int(sha256(test.encode()).hexdigest(), 16) % THIRDS == self.third

    def order(self, test: str) -> tuple[bool, str]:
        """Return the key of a long test in the order of a run.

        The third comes first, then file after file, at every count in another order: what finds no time varies.
        """
        if self.history is None:
            return False, ""
        file = test.partition("::")[0]
        return not self.is_in_third(test), sha256(f"{self.history.count} {file}".encode()).hexdigest()

    def is_chosen(self, test: str) -> bool:
        """Return whether a long test, by its name `FILE::NAME`, runs if there is time."""
        return self.is_in_third(test) or self.is_changed(test.partition("::")[0])

    def is_changed(self, file: str) -> bool:
        """Return whether a file of tests, a helper next to it, or what it tries has changed."""
        if self.history is None:
            return True
        tried, folder = tried_by(file), file.rpartition("/")[0]
        if not tried or not (ROOT / file).is_file():
            return True  # no row states what it tries
        return any(
            path == file
            or is_within(path, tried)
            or (folder != "tests" and path.rpartition("/")[0] == folder and not _is_tests(path))
            for path in self.history.changed
        )

    def last_begin_s(self, test: str, run_began_s: float, submission_began_s: float | None = None) -> float:
        """Return the time (s, POSIX) until which a chosen long test begins."""
        if submission_began_s is None:
            return math.inf if self.is_in_third(test) else run_began_s + CHANGED_BEGIN_WITHIN_S
        kept_s = sum(seconds for part, seconds in PART_S.items() if self.runs(part))
        return max(submission_began_s + SUBMISSION_S - kept_s - LAST_LONG_S, run_began_s + LEAST_LONG_S)

    def asks_for(self, part: str) -> list[str]:
        """Return the changed paths that ask for `bench` or `arm64`."""
        return sorted(p for p in self.history.changed if is_within(p, CHOSEN_BY[part])) if self.history else []

    def runs(self, part: str) -> bool:
        """Return whether `bench` or `arm64` runs."""
        return self.history is None or bool(self.asks_for(part))

    def lines(self) -> list[str]:
        """Return what is chosen and what is left out, with the reasons, in lines for people."""
        if self.history is None:
            return ["no history here (a shallow clone?): every long test, the bench and arm64 run"]
        files = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("test_*.py") if has_long(path))
        changed = [file for file in files if self.is_changed(file)]
        rest = [file for file in files if file not in changed]
        words = [
            f"long tests: third {self.third} of 0 to {THIRDS - 1}, as commit {self.history.count} has it, and all of "
            f"{len(changed)} files whose packages changed ({self.history.since}); of these what has not begun "
            f"{CHANGED_BEGIN_WITHIN_S / 60.0:.0f} minutes into the run, and in .ci/run of both what has not begun in "
            f"time for its end after {SUBMISSION_S / 60.0:.0f} minutes, is left out by name",
            *(f"  {file}" for file in changed),
            f"LEFT OUT: two thirds of the long tests of {len(rest)} files whose packages did not change:",
            *(f"  {file}" for file in rest),
        ]
        for part, paths in CHOSEN_BY.items():
            asking = self.asks_for(part)
            more = f" and {len(asking) - 3} more" if len(asking) > 3 else ""
            words.append(
                f"make test-{part} runs: {', '.join(asking[:3])}{more} changed"
                if asking
                else f"LEFT OUT: make test-{part}: nothing changed in {', '.join(paths)}"
            )
        return [*words, "everything: make test-all"]


def _is_tests(path: str) -> bool:
    return path.rpartition("/")[2].startswith("test_")


def has_long(path: Path) -> bool:
    """Return whether a file may hold long tests."""
    text = path.read_text(encoding="utf-8")
    return any(
        words in text for words in ("mark.long", "rest_long", "@given")
    )  # conftest.py makes properties long ones


def main(arguments: list[str]) -> int:
    """Print the choice, or answer by the exit code whether a part is chosen."""
    choice = Choice(history())
    if arguments:
        return 0 if choice.runs(arguments[0]) else 1
    print("\n".join(["what this submission runs", *choice.lines()]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
