"""These tests run with `make test-arm64` only: they build Debian packages and emulate a processor."""

import os

import pytest

from tests.measured import show_measured

collect_ignore_glob = [] if os.environ.get("POINTCLICK_ARM64") == "1" else ["test_*.py"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """What was measured, next to what was held."""
    show_measured(terminalreporter)
