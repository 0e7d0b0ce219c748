"""These tests run with `make test-arm64` only: they build Debian packages and emulate a processor."""

from __future__ import annotations

import os

import pytest

collect_ignore_glob = [] if os.environ.get("POINTCLICK_ARM64") == "1" else ["test_*.py"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """What was measured (`record_property`), beside what was held."""
    measured = [(r.head_line, r.user_properties) for r in terminalreporter.stats.get("passed", []) if r.user_properties]
    if measured:
        terminalreporter.section("measured")
    for name, figures in measured:
        terminalreporter.line(f"{name}: " + ", ".join(f"{key} {value}" for key, value in figures))
