"""What a submission runs follows from what changed: a third, changed packages, and the machines that they concern."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import submission
from tests.left_out import NO_TIME
from tests.long_tests import BEGAN_VARIABLE
from tests.submission import COMMITS, ROOT, THIRDS, TRIES, VARIABLE, Choice, History, has_long, history

LONG_FILES = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("test_*.py") if has_long(path))
NAMES = [f"{file}::test_{number}" for file in LONG_FILES for number in range(6)]


def choice(*changed: str, count: int = 1) -> Choice:
    return Choice(History(count, frozenset(changed), "since v1"))


class Repository:
    """A checkout with a history of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.git("init", "-q")

    def git(self, *words: str, date: str = "2020-01-01T00:00:00Z") -> None:
        who = ["-c", "user.name=t", "-c", "user.email=t@t"]
        env = {"PATH": "/usr/bin:/bin", "GIT_COMMITTER_DATE": date, "GIT_AUTHOR_DATE": date, "HOME": str(self.folder)}
        subprocess.run(["git", *who, *words], cwd=self.folder, env=env, check=True, capture_output=True)

    def commit(self, *paths: str, date: str = "2020-01-01T00:00:00Z") -> None:
        for path in paths:
            file = self.folder / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(f"{file.read_text() if file.exists() else ''}.")
            self.git("add", path)
        self.git("commit", "-q", "-m", "it", date=date)


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    """Thirty commits on one package after one on each of two others."""
    made = Repository(tmp_path)
    made.commit("ground/first.py")
    made.commit("onboard/vision/second.py")
    for _ in range(COMMITS):
        made.commit("onboard/camera/v4l2.py")
    return made


def changed(repository: Repository) -> set[str]:
    found = history(repository.folder)
    assert found is not None
    return set(found.changed)


def test_changed_is_what_the_last_commits_touched(repository: Repository) -> None:
    assert changed(repository) == {"onboard/camera/v4l2.py"}
    found = history(repository.folder)
    assert found is not None and found.count == COMMITS + 2


def test_a_day_of_more_commits_is_looked_at_whole(repository: Repository) -> None:
    repository.commit("ground/first.py", date="2099-01-01T00:00:00Z")
    for _ in range(COMMITS + 5):
        repository.commit("systemd/unit", date="2099-01-01T00:00:00Z")
    assert changed(repository) == {"ground/first.py", "systemd/unit"}


def test_nothing_before_the_newest_tag_counts(repository: Repository) -> None:
    repository.git("tag", "v1")
    assert changed(repository) == set()
    repository.commit("ground/first.py")
    assert changed(repository) == {"ground/first.py"}


def test_an_old_tag_changes_nothing(repository: Repository) -> None:
    repository.git("tag", "v1", "HEAD~31")
    assert changed(repository) == {"onboard/camera/v4l2.py"}


def test_what_is_not_committed_yet_has_changed(repository: Repository) -> None:
    (repository.folder / "ground" / "first.py").write_text("changed")
    assert changed(repository) == {"ground/first.py", "onboard/camera/v4l2.py"}


@pytest.mark.parametrize("kind", ["shallow", "short", "none"])
def test_without_a_history_everything_runs(repository: Repository, tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "other"
    if kind == "none":
        folder.mkdir()
        (folder / ".git").write_text("gitdir: nowhere")
    elif kind == "shallow":
        repository.git("clone", "-q", "--depth", "5", f"file://{repository.folder}", str(folder))
    else:
        folder.mkdir()
        Repository(folder).commit("ground/first.py")
    assert history(folder) is None
    every = Choice(None)
    assert all(every.is_chosen(name) for name in NAMES) and every.runs("bench") and every.runs("arm64")
    assert "everything" in " ".join(every.lines()) or "every long test" in " ".join(every.lines())


def test_three_submissions_in_a_row_run_every_long_test_once() -> None:
    thirds = [{name for name in NAMES if choice(count=count).is_chosen(name)} for count in (7, 8, 9)]
    assert set.union(*thirds) == set(NAMES) and sum(map(len, thirds)) == len(NAMES)
    assert all(0.25 < len(third) / len(NAMES) < 0.42 for third in thirds)
    assert thirds[0] == {name for name in NAMES if choice(count=7 + THIRDS).is_chosen(name)}


@pytest.mark.parametrize(
    ("path", "file", "is_all"),
    [
        ("onboard/link/rate.py", "tests/onboard/link/test_rate.py", True),
        ("onboard/link/rate.py", "tests/onboard/tracks/test_plane_filter.py", False),
        ("onboard/estimation/window.py", "tests/scenarios/test_climb.py", True),
        ("contract/locate.py", "tests/scenarios/test_climb.py", True),
        ("onboard/camera/v4l2.py", "tests/scenarios/test_climb.py", False),
        ("tests/scenarios/flights.py", "tests/scenarios/test_climb.py", True),
        ("tests/scenarios/test_climb.py", "tests/scenarios/test_climb.py", True),
        ("tests/scenarios/test_seen.py", "tests/scenarios/test_climb.py", False),
        ("requirements.lock", "tests/test_install.py", True),
        ("frontend/src/page.ts", "tests/web/test_open.py", True),
        ("ground/pins/store.py", "tests/ground/pins/test_fusion.py", True),
        ("docs/service.md", "tests/onboard/link/test_rate.py", False),
    ],
)  # fmt: skip
def test_every_long_test_of_a_changed_package_runs(path: str, file: str, is_all: bool) -> None:
    assert file in LONG_FILES
    names = [name for name in NAMES if name.startswith(file)]
    assert {name for name in names if choice(path).is_chosen(name)} == {
        name for name in names if is_all or choice().is_in_third(name)
    }


@pytest.mark.parametrize(
    ("path", "bench", "arm64"),
    [
        ("packaging/slim.py", True, True), ("onboard/camera/v4l2.py", True, True), ("requirements.lock", True, True),
        ("systemd/pointclick.service", True, True), ("onboard/link/rate.py", True, True),
        ("docs/test-bench.md", False, False),
        ("onboard/service/daemon.py", True, True), ("onboard/estimation/window.py", False, False),
        ("tests/bench/machine.py", True, False), ("tests/arm64/emulation.py", False, True),
        ("onboard/camera_like/x.py", False, False),
    ],
)  # fmt: skip
def test_other_machines_are_tried_where_what_they_try_changed(path: str, bench: bool, arm64: bool) -> None:
    assert (choice(path).runs("bench"), choice(path).runs("arm64")) == (bench, arm64)
    printed = "\n".join(choice(path).lines())
    assert ("LEFT OUT: make test-bench" in printed, "LEFT OUT: make test-arm64" in printed) == (not bench, not arm64)
    assert (path in printed) == (bench or arm64)


def test_what_is_left_out_is_listed_by_name() -> None:
    printed = choice("onboard/link/rate.py").lines()
    heads = [number for number, line in enumerate(printed) if "files whose packages" in line]
    assert "  tests/onboard/link/test_rate.py" in printed[heads[0] : heads[1]]
    assert "  tests/onboard/tracks/test_plane_filter.py" in printed[heads[1] :]


def test_the_third_comes_first_and_what_may_find_no_time_varies() -> None:
    orders = [sorted(NAMES, key=choice(count=count).order) for count in (3, 6)]
    for order in orders:
        chosen = [choice(count=3).is_in_third(name) for name in order]
        assert chosen == sorted(chosen, reverse=True)
    assert orders[0] != orders[1]


def test_each_file_states_what_it_tries() -> None:
    """By its place next to a package, or by a line of the table."""
    for file in LONG_FILES:
        package = file.removeprefix("tests/").rpartition("/")[0]
        assert (package and (ROOT / package).is_dir()) or any(file.startswith(tests) for tests in TRIES), file
    paths = {path for tried in TRIES.values() for path in tried}
    assert all((ROOT / path).exists() for path in {*paths, *TRIES})


def test_a_submission_ends_in_half_an_hour_whatever_runs_after_the_long_tests() -> None:
    """The last to begin leaves time for the bench and the packages where they run, the third's as well."""
    nothing, both = choice("docs/service.md"), choice("packaging/slim.py")
    of_third = next(name for name in NAMES if nothing.is_in_third(name))
    rest = next(name for name in NAMES if not nothing.is_in_third(name))
    for test in (of_third, rest):
        assert nothing.last_begin_s(test, 600.0, 100.0) == 100.0 + 1800.0 - submission.LAST_LONG_S
        kept_s = nothing.last_begin_s(test, 600.0, 100.0) - both.last_begin_s(test, 600.0, 100.0)
        assert kept_s == sum(submission.PART_S.values())
        assert (
            nothing.last_begin_s(test, 1700.0, 100.0) == 1700.0 + submission.LEAST_LONG_S
        )  # a slow machine: some are run all the same


def test_by_hand_the_third_runs_whole() -> None:
    of_third = next(name for name in NAMES if choice().is_in_third(name))
    rest = next(name for name in NAMES if not choice().is_in_third(name))
    assert choice().last_begin_s(of_third, 600.0) == math.inf and choice().last_begin_s(rest, 600.0) == 600.0 + 900.0


IN_A_CHECKOUT = "tests/onboard/link/test_rate.py"


def long_run(began_s: str, monkeypatch: pytest.MonkeyPatch, submission_began_s: str = "") -> str:
    """A run of the chosen long tests of two files without the tests' own work."""
    monkeypatch.setenv(VARIABLE, "chosen")
    monkeypatch.setenv(BEGAN_VARIABLE, began_s)
    monkeypatch.setenv(submission.BEGAN_VARIABLE, submission_began_s)
    done = subprocess.run(
        [sys.executable, "-c", f"""
import sys, pytest
import tests.long_tests as of_run
from tests.submission import Choice, History
of_run.history = lambda: History(3, frozenset({{"onboard/link/rate.py"}}), "since v1")
class NoWork:
    @pytest.hookimpl(tryfirst=True)
    def pytest_pyfunc_call(self, pyfuncitem):
        return True
sys.exit(pytest.main(["-m", "long", "-p", "no:cacheprovider", {IN_A_CHECKOUT!r},
    "tests/onboard/tracks/test_plane_filter.py"], plugins=[NoWork()]))
"""],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.long
def test_a_run_takes_what_is_chosen_and_names_what_found_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    in_time = long_run("9e18", monkeypatch)
    passed = int(re.findall(r"(\d+) passed", in_time)[0])
    left_out = int(re.findall(r"(\d+) LONG TESTS LEFT OUT", in_time)[0])
    assert "test_plane_filter.py: " in in_time and "NO TIME" not in in_time and 0 < left_out <= 8
    late = long_run("0", monkeypatch)
    no_time = int(re.findall(r"(\d+) LONG TESTS FOUND NO TIME", late)[0])
    assert 0 < no_time < passed and int(re.findall(r"(\d+) passed", late)[0]) == passed - no_time
    assert len(re.findall(rf"^  {IN_A_CHECKOUT}::", late, re.MULTILINE)) == no_time and NO_TIME in late
    too_late = long_run("0", monkeypatch, "0")
    assert f"{passed} LONG TESTS FOUND NO TIME" in too_late and "passed" not in too_late
