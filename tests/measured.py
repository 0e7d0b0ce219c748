"""What tests measured (`record_property`), shown at a run's end next to what was held."""

import pytest


def show_measured(reporter: pytest.TerminalReporter) -> None:
    """A line each test that passed and noted figures."""
    measured = [(r.head_line, r.user_properties) for r in reporter.stats.get("passed", []) if r.user_properties]
    if measured:
        reporter.section("measured")
    for name, figures in measured:
        reporter.line(f"{name}: " + ", ".join(f"{key} {value}" for key, value in figures))
