"""The tests of `inside/` run in a guest: their claims need a camera that is a device."""

from pathlib import Path

import pytest

from tests.bench import cameras
from tests.bench.machine import GUEST_CHECKOUT, INSIDE, PYTHON, boot

FILES = sorted(path.name for path in (Path(__file__).parent / "inside").glob("test_*.py"))
TRIED_AGAIN = ("test_libcamera.py",)  # it plugs vimc in again


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=cameras.tried_again if name in TRIED_AGAIN else ()) for name in FILES]
)
def test_inside_a_guest(name: str) -> None:
    with boot() as guest:
        cameras.load(guest)
        path = f"tests/bench/inside/{name}"
        done = guest.run(PYTHON, "-m", "pytest", path, timeout_s=180.0, cwd=GUEST_CHECKOUT, env=INSIDE)
        assert done.code == 0, f"{done.text}\n{guest.journal(80)}"
