"""A test that hangs ends with its name and its stacks; properties have many examples in a long run."""

from pathlib import Path

import pytest
from hypothesis import settings

from tests.conftest import EXAMPLES, asks_for_long
from tests.inner_run import inner_run
from tests.limits import GUEST_S, LONG_S, ORDINARY_S, TESTS, limit_s

HANGS = """
import threading
import pytest

@pytest.fixture
def never():
    threading.Event().wait()

@pytest.mark.timeout(1)
def test_that_waits_for_ever():
    threading.Event().wait()

@pytest.mark.timeout(1)
def test_whose_fixture_waits_for_ever(never):
    pass

def test_after_it():
    pass
"""


def test_this_test_has_the_limit_of_ordinary_ones(request: pytest.FixtureRequest) -> None:
    marker = request.node.get_closest_marker("timeout")
    assert marker is not None and marker.args == (ORDINARY_S,)
    assert request.config.pluginmanager.has_plugin("timeout")


@pytest.mark.timeout(77)
def test_a_limit_of_its_own_is_kept(request: pytest.FixtureRequest) -> None:
    assert request.node.get_closest_marker("timeout").args == (77,)


@pytest.mark.parametrize(("folder", "is_long", "expected_s"), [
    ("contract", False, ORDINARY_S), ("scenarios", True, LONG_S), ("bench", False, GUEST_S), ("arm64", True, GUEST_S),
])  # fmt: skip
def test_the_limit_is_by_marker_and_folder(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, folder: str, is_long: bool, expected_s: float
) -> None:
    monkeypatch.setattr(request.node, "path", TESTS / folder / "test_it.py")
    if is_long:
        request.node.add_marker("long")
    assert limit_s(request.node) == expected_s


@pytest.mark.long
def test_one_that_hangs_is_named_by_its_worker_and_the_others_run(tmp_path: Path) -> None:
    (tmp_path / "test_hanging.py").write_text(HANGS)
    done = inner_run("-q", "-n", "1", folder=tmp_path)
    assert "1 passed, 1 failed, 1 error" in done.stdout.replace("1 failed, 1 passed", "1 passed, 1 failed")
    assert "FAILED test_hanging.py::test_that_waits_for_ever - Failed: Timeout" in done.stdout
    assert "ERROR test_hanging.py::test_whose_fixture_waits_for_ever - Failed: Timeout" in done.stdout


@pytest.mark.parametrize(
    ("expression", "is_long"),
    [
        ("long and not wall_clock", True), ("long and wall_clock", True), ("long", True), ("", False),
        ("not long and not wall_clock", False), ("not long", False), ("wall_clock", False),
        ("long or wall_clock", False),
    ],
)  # fmt: skip
def test_a_run_of_long_tests_is_known_by_its_expression(expression: str, is_long: bool) -> None:
    assert asks_for_long(expression) is is_long


@pytest.mark.long
def test_a_property_is_tried_with_more_examples_in_the_long_run(request: pytest.FixtureRequest) -> None:
    """Of the run that this test is in, and of another of long tests."""
    is_long = asks_for_long(request.config.option.markexpr)
    if not request.config.getoption("--hypothesis-profile"):
        assert settings().max_examples == EXAMPLES["many" if is_long else "few"]
    name = "test_any_bytes_are_a_set_or_a_named_error"
    done = inner_run("tests/contract/test_codec.py", "-m", "long", "--hypothesis-show-statistics", "-k", name)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"settings.max_examples={EXAMPLES['many']}" in done.stdout
