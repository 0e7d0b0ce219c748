"""What every test may ask for: one thread each, the shared recordings, and a loud word about tests left out."""

import gc
import os
import shutil
import signal
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from _pytest.mark.expression import Expression
from hypothesis import settings

from tests import postgres
from tests.costly_first import COSTLY_FIRST
from tests.flights_folder import FLIGHTS_VARIABLE
from tests.left_out import LEFT_OUT, NO_PROGRAM
from tests.limits import limit
from tests.long_tests import register
from tests.rewriting import rewrite_once

# Before anything imports NumPy or OpenCV: several tests run side by side, and one thread each gives the same bytes
# everywhere.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ[variable] = "1"
os.environ["OPENCV_OPENCL_RUNTIME"] = "disabled"

# What a shell without job control starts in the background ignores SIGINT, as would programs that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# An example's time says how loaded the machine is; what must be quick has a test of its own. The same examples every
# run: a change is judged by itself and not by what chance found; `--hypothesis-profile=default` looks further. A run of
# long tests has eight times as many, and each property among its tests.
EXAMPLES = {"few": 25, "many": 200}
for profile, examples in EXAMPLES.items():
    settings.register_profile(profile, deadline=None, derandomize=True, max_examples=examples)
settings.load_profile("few")

CHECKOUT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The real flight and the long recordings, too large or not ours to commit.

    `../shared/data` next to the checkout, or where POINTCLICK_SHARED says. Without them the test is left out, and the
    run's end says so.
    """
    folder = Path(os.environ.get("POINTCLICK_SHARED") or CHECKOUT.parent / "shared" / "data")
    if not (folder / "cmac_2018" / "frames").is_dir() or not (folder / "sitl").is_dir():
        pytest.skip(f"{LEFT_OUT} {folder}")
    return folder


@pytest.fixture(scope="session")
def systemd_analyze() -> str:
    """Reads units. `make test` installs it where it may; else the run's end says what was not tested."""
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip(f"{NO_PROGRAM} systemd-analyze; sudo apt-get install systemd")
    return program


@pytest.fixture(scope="session")
def gstreamer() -> None:
    """It and its RTSP server. `make test` installs it where it may; else the run's end says what was not tested."""
    from tests import rtsp  # noqa: PLC0415  NumPy, not before the variables above

    if not rtsp.is_installed():
        pytest.skip(f"{NO_PROGRAM} gstreamer; sudo apt-get install {rtsp.PACKAGES}")


@pytest.fixture(scope="session")
def postgresql() -> Iterator[postgres.Server]:
    """A real server. `make test` installs it where it may; else the run's end says what was not tested."""
    if postgres.programs() is None:
        pytest.skip(f"{NO_PROGRAM} postgres; sudo apt-get install {postgres.PACKAGES}")
    with postgres.running() as server:
        yield server


def pytest_configure(config: pytest.Config) -> None:
    """One folder for the flights of all workers: the first to need a flight draws it, the others find it.

    So it is with the ground they fly over, for programs that tests start, too. `make pytest` names a folder for both of
    its runs.
    """
    expression = config.option.markexpr
    if asks_for_long(expression) and not config.getoption("--hypothesis-profile"):
        settings.load_profile("many")
    register(config, "not long" in expression and may_be_chosen(expression, ""))  # then every file is looked at
    if not hasattr(config, "workerinput"):
        from simulation.kept_drawings import FOLDER_VARIABLE  # noqa: PLC0415  NumPy, not before the variables above

        if not os.environ.get(FLIGHTS_VARIABLE):
            folder = TemporaryDirectory(prefix="flights-")
            os.environ[FLIGHTS_VARIABLE] = folder.name
            config.add_cleanup(folder.cleanup)
        os.environ[FOLDER_VARIABLE] = str(Path(os.environ[FLIGHTS_VARIABLE]) / "drawings")
        if config.getoption("numprocesses", 0):
            rewrite_once(config, [file for file in files_of_tests(config) if not pytest_ignore_collect(file, config)])


@pytest.hookimpl(wrapper=True)  # around pytest-xdist, which looks at the groups
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Those next to this file come first, for the longest are among them: one that began last would end alone.

    Without the long tests a file is one worker's: what its tests share is made once, and workers that wait, as all of
    a file on the link do, are next to others that calculate; the costliest groups come first. Long tests are few to a
    file and take minutes each. (pytest-xdist keeps this order with --no-loadscope-reorder only.) Of those that measure
    real time, the ones that mostly wait are one worker's by file, next to another's that do not.
    """
    if asks_for_long(config.option.markexpr):
        for item in items:
            if getattr(getattr(item, "obj", None), "is_hypothesis_test", False):
                item.add_marker("long")
    limit(items)
    here = Path(__file__).parent
    items.sort(key=lambda item: item.path.parent != here)
    for item in items:
        if (group := real_time_group(item)) is not None:
            item.add_marker(pytest.mark.xdist_group(group), append=False)
    if "not long" in config.option.markexpr:
        rank = {group: number for number, group in enumerate(COSTLY_FIRST)}
        for item in items:
            if item.get_closest_marker("xdist_group") is None:
                item.add_marker(pytest.mark.xdist_group(item.path.stem))
        items.sort(key=lambda item: rank.get(group_of(item), len(rank)))
    yield
    # Of several groups pytest-xdist makes another one, and two that measure would be next to each other.
    for item in items if config.getoption("loadgroup", False) else ():
        if (group := real_time_group(item)) is not None:
            item._nodeid = f"{item.nodeid.rpartition('@')[0]}@{group}"


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Leave what collecting makes out of garbage collection: all of it stays, and each full round would look at it."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def real_time_group(item: pytest.Item) -> str | None:
    """Of one that measures real time, whatever other group it is of."""
    measured = item.get_closest_marker("wall_clock")
    if measured is None:
        return None
    return f"waits {item.path.stem}" if measured.kwargs.get("waits") else "measures"


def group_of(item: pytest.Item) -> str:
    """The name of the tests that one worker runs together."""
    marker = item.get_closest_marker("xdist_group")
    assert marker is not None
    return str(marker.args[0])


def files_of_tests(config: pytest.Config) -> list[Path]:
    """Return the files of tests below what the command line names."""
    named = [Path(argument.partition("::")[0]) for argument in config.args]
    return [file for path in named for file in ([path] if path.is_file() else sorted(path.rglob("test_*.py")))]


MARKERS = ("long", "wall_clock")
PROPERTY = "@given"  # of hypothesis: in a run of long tests all of them are


def asks_for_long(expression: str) -> bool:
    """Return whether `-m expression` chooses long tests and no others."""
    chosen = Expression.compile(expression) if expression else None
    return chosen is not None and not any(
        chosen.evaluate(lambda name, /, **_: name in have)  # noqa: B023  evaluated here
        for have in ((), ("wall_clock",))
    )


def may_be_chosen(expression: str, text: str) -> bool:
    """Whether a file of tests can hold one that `-m expression` chooses: some of the markers that it names would do."""
    named = [marker for marker in MARKERS if marker in text or (marker == "long" and PROPERTY in text)]
    chosen = Expression.compile(expression)
    return any(
        chosen.evaluate(lambda name, /, **_: name in have)  # noqa: B023  evaluated here
        for count in range(len(named) + 1)
        for have in combinations(named, count)
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A run of marked tests alone does not import the many files without any, which takes each worker seconds."""
    if collection_path.suffix != ".py" or not config.option.markexpr:
        return None
    text = collection_path.read_text(encoding="utf-8")
    return None if may_be_chosen(config.option.markexpr, text) else True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name every test that was left out for want of the shared recordings, or of a program."""
    for report in terminalreporter.stats.get("skipped", []):
        if NO_PROGRAM in str(report.longrepr):
            terminalreporter.section("A TEST LEFT OUT", sep="!", red=True, bold=True)
            terminalreporter.line(f"{report.nodeid}: {report.longrepr[-1]}")
    missing = [r for r in terminalreporter.stats.get("skipped", []) if LEFT_OUT in str(r.longrepr)]
    if not missing:
        return
    folder = str(missing[0].longrepr[-1]).split(LEFT_OUT)[1].strip(" '\")")
    terminalreporter.section(f"{len(missing)} TESTS LEFT OUT", sep="!", red=True, bold=True)
    terminalreporter.line(f"No recordings at {folder}: what follows was NOT tested.")
    terminalreporter.line("Put the folder there or name it in POINTCLICK_SHARED to run these too:")
    for name in sorted(r.nodeid for r in missing):
        terminalreporter.line(f"  {name}")
