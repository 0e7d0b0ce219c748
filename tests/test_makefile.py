"""`make pytest` runs two sets of tests, those that measure real time alone, and fails if either fails or is missing."""

import os
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import may_be_chosen
from tests.costly_first import COSTLY_FIRST
from tests.inner_run import inner_run

ROOT = Path(__file__).resolve().parents[1]
PARALLEL = "-n 3 --dist loadgroup --no-loadscope-reorder --durations=30"
REAL_TIME = "-n 4 --dist loadgroup --reruns 2 -rR --durations=30"


def make_pytest(
    folder: Path, parallel: int, serial: int, arguments: str = "", target: str = "pytest", types: int = 0
) -> tuple[int, list[str], str]:
    """`make pytest` with a pytest that ends with these codes: make's own code, the two calls, what was said."""
    programs = folder / "venv" / "bin"
    programs.mkdir(parents=True)
    calls = folder / "calls"
    # Whatever else make runs with it, such as the page's build where that is missing, is well and not counted.
    fake = (
        f'#!/bin/sh\ncase "$*" in "-m pytest"*) echo "$@" >> {calls};; *) exit 0;; esac\n'
        f'case "$*" in *"not wall_clock"*) exit {parallel};; *) exit {serial};; esac\n'
    )
    others = {"systemd-analyze": "#!/bin/sh\n", "ruff": "#!/bin/sh\n", "mypy": f"#!/bin/sh\nexit {types}\n"}
    for name, text in {"python": fake, **others}.items():
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    for stamp in (".locked", ".installed"):  # newer than the lock: nothing to install
        (folder / "venv" / stamp).touch()
    done = subprocess.run(
        ["make", target, f"VENV={folder / 'venv'}", f"PYTEST_ARGS={arguments}"],
        cwd=ROOT,
        env={"PATH": f"{programs}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=30,
    )
    return done.returncode, calls.read_text().splitlines(), done.stdout + done.stderr


@pytest.mark.parametrize(
    ("target", "serial", "chosen"),
    [
        pytest.param("pytest", 0, "not long", id="the short ones"),
        pytest.param("test-long", 5, "long", id="the long ones, of which none may measure it"),
    ],
)
def test_real_time_is_measured_after_the_others(tmp_path: Path, target: str, serial: int, chosen: str) -> None:
    code, calls, _ = make_pytest(tmp_path, 0, serial, target=target)
    assert code == 0
    assert calls == [
        f"-m pytest -m {chosen} and not wall_clock {PARALLEL}",
        f"-m pytest -m {chosen} and wall_clock {REAL_TIME}",
    ]


def test_only_what_measures_real_time_is_tried_again_and_each_use_is_listed() -> None:
    runs = [line for line in (ROOT / "Makefile").read_text().splitlines() if "-m pytest" in line]
    tried_again = [line for line in runs if "--reruns" in line]
    assert len(runs) >= 3 and len(tried_again) == 1
    assert "and wall_clock" in tried_again[0] and "-rR" in tried_again[0]


def test_the_python_lines_that_look_at_our_own_modules_run() -> None:
    """`make install` asks an installed module where the page is; where that line fails it states that there is none."""
    lines = re.findall(r"bin/python\" (-\S+ )?-c '(import ground[^']*)'", (ROOT / "Makefile").read_text())
    assert lines
    for options, line in lines:
        assert options == "-I ", "the folder that it runs in would stand in for what was installed"
        done = subprocess.run([sys.executable, "-I", "-c", line], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert Path(done.stdout.strip()) == ROOT / "ground" / "web" / "static"


@pytest.mark.parametrize(("parallel", "serial"), [(1, 0), (0, 1), (5, 0), (5, 5)])
def test_a_failure_or_a_lost_marker_fails_the_long_run(tmp_path: Path, parallel: int, serial: int) -> None:
    assert make_pytest(tmp_path, parallel, serial, target="test-long")[0] != 0


@pytest.mark.parametrize(("parallel", "serial", "is_well"), [(0, 0, True), (1, 0, False), (0, 1, False)])
def test_a_submission_runs_long_tests_bench_and_packages_and_each_may_fail_it(
    tmp_path: Path, parallel: int, serial: int, is_well: bool
) -> None:
    """Of the fake's codes the bench and the packages end with the second."""
    code, calls, _ = make_pytest(tmp_path, parallel, serial, target="test-submission")
    assert (code == 0) is is_well
    assert [sum(words in call for call in calls) for words in ("long and", "tests/bench", "tests/arm64")] == [2, 1, 1]


@pytest.mark.parametrize(
    ("words", "chosen"),
    [("", "chosen"), ("ALL=1", ""), ("PYTEST_ARGS=-kclick", "")],
    ids=["all by turns", "ALL", "args"],
)
def test_the_long_run_chooses_but_where_all_or_some_are_asked_for(words: str, chosen: str) -> None:
    env = {k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKEOVERRIDES", "PYTEST_ARGS")}
    command = ["make", "-n", "test-long", *words.split()]
    shown = subprocess.run(command, env=env, cwd=ROOT, capture_output=True, text=True, check=True, timeout=30).stdout
    assert f"export POINTCLICK_LONG={chosen};" in shown


def test_make_test_reports_the_long_tests_that_it_leaves_out(tmp_path: Path) -> None:
    assert "LEFT OUT: the tests marked long" in make_pytest(tmp_path, 0, 0, target="test")[2]


FILES = ["tests/contract/test_bits.py", "tests/ground/pins/test_fusion.py"]


@cache
def without_long_tests(workers: int) -> str:
    """What a run of these files prints."""
    words = ["-n", str(workers), "--dist", "loadgroup", "-m", "not long", "-vv", "-k", "not ninety and not surer_than"]
    done = inner_run(*words, *FILES)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.long
@pytest.mark.parametrize("workers", [2, 0])
def test_a_run_names_the_files_whose_long_tests_it_leaves_out(workers: int) -> None:
    assert "LONG TESTS LEFT OUT" in without_long_tests(workers)
    assert re.search(r"test_fusion\.py: [1-9]", without_long_tests(workers))


def test_what_runs_on_a_submission_is_all_that_is_quick_and_what_is_chosen_of_the_rest() -> None:
    assert {"make test", "make test-submission"} <= set((ROOT / ".ci" / "run").read_text().splitlines())


@pytest.mark.parametrize(("parallel", "serial"), [(1, 0), (0, 1), (5, 0), (0, 5), (5, 5), (2, 5), (5, 2)])
def test_a_failure_or_an_empty_run_fails(tmp_path: Path, parallel: int, serial: int) -> None:
    code, calls, printed = make_pytest(tmp_path, parallel, serial)
    assert code != 0
    assert len(calls) == 2  # a failure in one does not hide what the other finds
    assert ("is a marker lost" in printed) == ({parallel, serial} == {0, 5})


@pytest.mark.parametrize(("types", "parallel", "is_well"), [(0, 0, True), (1, 0, False), (0, 1, False), (1, 1, False)])
def test_types_are_checked_next_to_the_tests_and_either_fails(
    tmp_path: Path, types: int, parallel: int, is_well: bool
) -> None:
    code, calls, printed = make_pytest(tmp_path, parallel, 0, target="test", types=types)
    assert (code == 0) is is_well
    assert len(calls) == 2
    assert ("make types failed" in printed) == bool(types)


@pytest.mark.parametrize(("parallel", "serial", "is_well"), [(0, 5, True), (5, 0, True), (5, 5, False), (1, 5, False)])
def test_chosen_tests_may_all_be_in_one_run(tmp_path: Path, parallel: int, serial: int, is_well: bool) -> None:
    code, calls, _ = make_pytest(tmp_path, parallel, serial, "-k 'click or terrain'")
    assert (code == 0) is is_well
    assert all(call.endswith("-k click or terrain") for call in calls)


def test_the_markers_are_registered() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    assert {line.split(":")[0] for line in options["markers"]} == {"wall_clock", "long"}


@pytest.mark.long
def test_without_the_long_tests_a_file_is_one_workers() -> None:
    workers = {file: set(re.findall(rf"\[(gw\d)\] .*PASSED {file}::", without_long_tests(2))) for file in FILES}
    assert [len(of_file) for of_file in workers.values()] == [1, 1]
    assert len(set.union(*workers.values())) == 2


def test_each_group_that_begins_early_is_there() -> None:
    files = list((ROOT / "tests").rglob("test_*.py"))
    named = {name for file in files for name in re.findall(r'xdist_group\("([^"]+)"\)', file.read_text())}
    table = (ROOT / "tests" / "scenarios" / "test_scenarios.py").read_text()
    named |= {f"scenarios: {heading}" for heading in re.findall(r'^    "([\w ]+)": \[$', table, re.MULTILINE)}
    assert len(set(COSTLY_FIRST)) == len(COSTLY_FIRST)
    assert set(COSTLY_FIRST) <= named | {file.stem for file in files}


@pytest.mark.long
def test_the_costliest_groups_begin_first() -> None:
    """By the order in which one worker runs them: pytest-xdist hands groups out in that of its first worker."""
    files = ("tests/test_equations.py", "tests/onboard/link/test_publisher.py", "tests/ground/test_router.py")
    done = inner_run("--collect-only", "-m", "not long and not wall_clock", *files)
    collected = list(dict.fromkeys(re.findall(r"(test_\w+)\.py::", done.stdout)))
    assert collected == ["test_router", "test_publisher", "test_equations"]


@pytest.mark.parametrize(
    ("expression", "text", "is_chosen"),
    [
        ("not long and not wall_clock", "", True), ("not long and not wall_clock", "long wall_clock", True),
        ("not long and wall_clock", "", False), ("not long and wall_clock", "mark.wall_clock", True),
        ("long and not wall_clock", "mark.wall_clock", False), ("long and not wall_clock", "mark.long", True),
        ("long and wall_clock", "mark.long", False), ("long or wall_clock", "mark.long", True),
    ],
)  # fmt: skip
def test_files_that_can_hold_none_of_the_chosen_tests_are_not_imported(
    expression: str, text: str, is_chosen: bool
) -> None:
    assert may_be_chosen(expression, text) is is_chosen


@pytest.mark.wall_clock
@pytest.mark.xdist_group("another")
def test_those_that_measure_are_one_workers_whatever_group_they_are_of(request: pytest.FixtureRequest) -> None:
    assert "@" not in request.node.nodeid or request.node.nodeid.endswith("@measures")


@pytest.mark.long
def test_what_a_group_shares_is_made_by_one_worker(tmp_path: Path) -> None:
    """pytest-xdist keeps a group together by a name it hangs on each test; with some pytests it silently does not."""
    (tmp_path / "test_of_a_group.py").write_text(
        'import pytest\n\n\n@pytest.mark.xdist_group("kept together")\ndef test_it(request):\n'
        '    assert request.node.nodeid.endswith("@kept together")\n'
    )
    done = inner_run("-n", "1", "--dist", "loadgroup", folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
