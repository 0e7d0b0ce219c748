"""The tests of `inside/` run in a guest: their claims need a camera that is a device."""

from pathlib import Path

import pytest

from tests.bench import cameras
from tests.bench.machine import GUEST_CHECKOUT, INSIDE, PYTHON, boot

FILES = sorted(path.name for path in (Path(__file__).parent / "inside").glob("test_*.py"))
WITHIN_S = 600.0
"""The time that a file may take, s: the longest takes two minutes on an idle machine."""


@pytest.mark.parametrize("name", FILES)
def test_inside_a_guest(name: str) -> None:
    with boot() as guest:
        cameras.load(guest)
        path = f"tests/bench/inside/{name}"
        done = guest.run(PYTHON, "-m", "pytest", path, timeout_s=WITHIN_S, cwd=GUEST_CHECKOUT, env=INSIDE)
        assert done.code == 0, f"{done.text}\n{guest.journal(80)}"
