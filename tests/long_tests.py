"""The long tests of a run: those that a submission chooses (`tests/submission.py`), and word of those left out."""

import os
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.left_out import NO_TIME
from tests.submission import BEGAN_VARIABLE as SUBMISSION_BEGAN_VARIABLE
from tests.submission import VARIABLE, Choice, history

CHECKOUT = Path(__file__).resolve().parents[1]
BEGAN_VARIABLE = "POINTCLICK_LONG_BEGAN"


class LongTests:
    """The number of long tests that a run leaves out, by file. The first worker reports: each collects all."""

    def __init__(self, config: pytest.Config, how_to_run: str) -> None:
        self._config = config
        self._how_to_run = how_to_run
        self._left_out: Counter[str] = Counter()

    def pytest_deselected(self, items: Sequence[pytest.Item]) -> None:
        long = [item for item in items if item.get_closest_marker("long")]
        self._left_out.update(str(item.path.relative_to(CHECKOUT)) for item in long)

    def pytest_sessionfinish(self) -> None:
        if hasattr(self._config, "workeroutput"):
            self._config.workeroutput["long"] = dict(self._left_out)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        self._left_out = self._left_out or Counter(getattr(node, "workeroutput", {}).get("long", {}))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if self._left_out:
            terminalreporter.section(f"{self._left_out.total()} LONG TESTS LEFT OUT", sep="!", red=True, bold=True)
            terminalreporter.line(f"To run them: {self._how_to_run}")
            for file, count in sorted(self._left_out.items()):
                terminalreporter.line(f"  {file}: {count}")
        late = [r.nodeid for r in terminalreporter.stats.get("skipped", []) if NO_TIME in str(r.longrepr)]
        if late:
            terminalreporter.section(f"{len(late)} LONG TESTS FOUND NO TIME", sep="!", red=True, bold=True)
            terminalreporter.line("They were chosen, and were NOT run. To run them: make test-long ALL=1")
            for name in sorted(late):
                terminalreporter.line(f"  {name}")


class ChosenLongTests(LongTests):
    """The long tests that a submission runs: its third, then those of changed packages, each until its time is over."""

    def __init__(self, config: pytest.Config, choice: Choice | None = None) -> None:
        super().__init__(config, "make test-long ALL=1")
        self._choice = choice or Choice(history())
        os.environ.setdefault(BEGAN_VARIABLE, str(time.time()))  # once a run: workers inherit it
        submission = os.environ.get(SUBMISSION_BEGAN_VARIABLE)
        self._began_s = float(os.environ[BEGAN_VARIABLE]), float(submission) if submission else None

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        names = {item: item.nodeid.partition("@")[0] for item in items}
        left_out = [
            item for item in items if item.get_closest_marker("long") and not self._choice.is_chosen(names[item])
        ]
        if left_out:
            config.hook.pytest_deselected(items=left_out)
        gone = set(left_out)
        items[:] = sorted(
            (item for item in items if item not in gone), key=lambda item: self._choice.order(names[item])
        )

    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        name = item.nodeid.partition("@")[0]
        if item.get_closest_marker("long") and time.time() > self._choice.last_begin_s(name, *self._began_s):
            pytest.skip(NO_TIME)


def register(config: pytest.Config, leaves_long_out: bool) -> None:
    """Have a run choose among long tests, where it is asked to, or report which it leaves out."""
    if os.environ.get(VARIABLE) == "chosen":
        config.pluginmanager.register(ChosenLongTests(config))
    elif leaves_long_out:
        config.pluginmanager.register(LongTests(config, "make test-long ALL=1"))
