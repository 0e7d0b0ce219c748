"""The bench's tests run with `make test-bench` only; those in `inside/` run in the guest, by `test_inside.py`."""

import os
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.measured import show_measured

ON_THE_HOST = os.environ.get("POINTCLICK_BENCH") == "1"
IN_THE_GUEST = os.environ.get("POINTCLICK_IN_GUEST") == "1"

collect_ignore_glob = ["inside/*"] if not IN_THE_GUEST else []
if not ON_THE_HOST:
    collect_ignore_glob.append("test_*.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give one worker the tests of a file, which share a guest; those of test_inside.py have one each."""
    for item in items:
        if item.path.parent == Path(__file__).parent and item.path.name != "test_inside.py":
            item.add_marker(pytest.mark.xdist_group(item.path.name))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failure shows the journal of the guest it happened on: of a fixture that is one, or has one as `machine`."""
    report = yield
    if not report.failed:
        return report
    from tests.bench.machine import Machine  # noqa: PLC0415  (in the guest there is none)

    for value in getattr(item, "funcargs", {}).values():
        machine = getattr(value, "machine", value)
        if isinstance(machine, Machine):
            report.sections.append(("journal of the guest", machine.journal()))
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """What was measured, next to what was held."""
    show_measured(terminalreporter)
