"""`pc-ground look`: what is asked, confirmed and printed; with an aircraft that answers and an autopilot of words."""

import dataclasses
import os
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from contract.answer import Fix
from contract.link_config import Rights, Tls
from contract.locate import Locator
from contract.look import Offer
from contract.topics import STATUS
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import decode
from ground.__main__ import main
from ground.commands.look import _is_yes, in_words
from onboard.config.link import Look
from onboard.events.pointing import ACCEPTED, CircleAbout, LookAhead, LookAt, Order
from onboard.link.certificates import make_credentials
from onboard.link.publisher import Publisher, Rate
from onboard.service.look_thread import LookThread
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually


@dataclass
class Autopilot:
    order: Order = field(default_factory=LookAhead)
    asked: int = 0
    word: str = ACCEPTED

    def command(self, order: Order) -> str:
        self.order, self.asked = order, self.asked + 1
        return self.word

    def height_amsl_m(self) -> float | None:
        return 1200.0


@dataclass(frozen=True)
class Place:
    options: list[str]
    autopilot: Autopilot
    publisher: Publisher
    fix: Fix


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    make_credentials(tmp_path, ["uav-1"], ["anna", "ben"], [], 30.0)
    endpoint, autopilot = free_endpoint().replace("tcp/", "tls/"), Autopilot()
    tls = Tls.in_folder(tmp_path / "uav-1")
    with (
        Publisher("uav-1", [endpoint], rate=Rate(1e6), tls=tls, rights=Rights(pointers=["anna"])) as flying,
        LookThread(Look(max_radius_m=40.0, circle_radius_m=120.0), flying.set_of, autopilot) as looks,
    ):
        flying.have_look = looks.ask
        made = dataclasses.replace(plain_set(), capture_unix_ns=time.time_ns())
        fix = Locator(decode(flying.publish(made))).locate((320.0, 240.0))
        assert isinstance(fix, Fix)
        yield Place(["--connect", endpoint, "--credentials", str(tmp_path / "anna")], autopilot, flying, fix)


def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ground.commands.look._is_someone_there", lambda: True)
    monkeypatch.setattr("ground.commands.look._forget_what_was_typed", lambda: None)


def test_a_click_is_confirmed_by_its_place_and_height_before_anything_moves(
    place: Place, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    printed: list[str] = []

    def answer(reply: str) -> str:
        assert place.autopilot.asked == 0
        printed.append(capsys.readouterr().out)
        return reply

    at_a_terminal(monkeypatch)
    monkeypatch.setattr("builtins.input", lambda _: answer("n"))
    assert eventually(lambda: main(["look", "320", "240", *place.options]) == 3)
    assert "not confirmed: nothing was sent" in capsys.readouterr().err and place.autopilot.asked == 0
    monkeypatch.setattr("builtins.input", lambda _: answer("y"))
    assert eventually(lambda: main(["look", "320", "240", *place.options]) == 0)
    assert f"{place.fix.height_amsl_m:.0f} m above sea level (90 % within" in printed[-1]
    assert f"look at {place.fix.lat_deg:.5f} {place.fix.lon_deg:.5f}, " in printed[-1]
    assert capsys.readouterr().out == "uav-1: accepted by the autopilot\n"
    order = place.autopilot.order
    assert isinstance(order, LookAt) and abs(order.lat_deg - place.fix.lat_deg) < 1e-7
    assert order.height_amsl_m == place.fix.height_amsl_m


def test_a_program_confirms_beforehand_and_ends_it(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["look", "320", "240", "--frame", "77", "--yes", *place.options]
    assert eventually(lambda: main(command) == 0)
    assert isinstance(place.autopilot.order, LookAt)
    assert eventually(lambda: main(["look", "--ahead", *place.options]) == 0)  # refused for two seconds: busy
    assert place.autopilot.order == LookAhead() and "looks ahead again" in capsys.readouterr().out


def test_a_circle_is_confirmed_by_itself_with_its_own_height(
    place: Place, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    replies = {"Have the camera look there? [y/N] ": "y", "Have the aircraft circle there? [y/N] ": "n"}
    at_a_terminal(monkeypatch)
    monkeypatch.setattr("builtins.input", lambda question: replies[question])
    command = ["look", "320", "240", "--circle", *place.options]
    assert eventually(lambda: main(command) == 3 and isinstance(place.autopilot.order, LookAt))
    printed = capsys.readouterr()
    above = f"1200 m above sea level, {1200.0 - (place.fix.height_amsl_m or 0.0):.0f} m above the place, radius 120 m"
    assert above in printed.out and "no circle was sent; the camera still looks there" in printed.err
    replies["Have the aircraft circle there? [y/N] "] = "y"

    def circles() -> bool:  # refused for two seconds after the look
        main(command)
        return isinstance(place.autopilot.order, CircleAbout)

    monkeypatch.setattr("ground.commands.look._is_yes", lambda question: time.sleep(2.1) or True)
    assert eventually(circles)
    assert isinstance(order := place.autopilot.order, CircleAbout) and order.height_amsl_m == 1200.0
    assert main([*command, "--yes"]) == 2 and "--circle goes without --yes" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform == "win32", reason="its terminals are others")
def test_a_key_pressed_before_the_question_was_there_confirms_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, terminal = os.openpty()
    with os.fdopen(keyboard, "wb", 0) as keys, os.fdopen(terminal) as typed:
        monkeypatch.setattr("sys.stdin", typed)
        keys.write(b"y\ny\n")  # as one who waits for the first question does, twice
        for reply, is_yes in ((b"n\n", False), (b"y\n", True), (b"\n", False)):

            def answer(_: str, reply: bytes = reply) -> str:
                keys.write(reply)
                return typed.readline()

            monkeypatch.setattr("builtins.input", answer)
            assert _is_yes("Have the aircraft circle there?") == is_yes


@pytest.mark.parametrize("piped", ["stdin", "stdout"])
def test_a_place_that_no_one_reads_or_no_one_confirms_is_not_asked_for(
    piped: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("stdin", "stdout"):
        monkeypatch.setattr(f"sys.{name}.isatty", lambda name=name: name != piped, raising=False)
    assert main(["look", "320", "240", "--circle", "--credentials", "none"]) == 2
    assert "no one is there to read and confirm" in capsys.readouterr().err


def test_interrupted_after_it_was_confirmed_it_is_not_stated_that_nothing_was_done(
    place: Place, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def confirm(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ground.look_link.LookLink.confirm", confirm)
    assert eventually(lambda: main(["look", "320", "240", "--yes", *place.options]) == 130)
    assert "it may have been done or not" in capsys.readouterr().err


def test_a_refusal_is_a_line_and_exit_3(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    place.autopilot.word = "unsupported"
    command = ["look", "320", "240", "--yes", *place.options]
    assert eventually(lambda: main(command) == 3)
    assert "unsupported: the autopilot refuses: unsupported" in capsys.readouterr().err
    assert main(["look", "320", "9999", "--yes", *place.options]) == 3
    assert "outside" in capsys.readouterr().err and place.autopilot.asked == 1


def test_a_certificate_that_is_not_named_gets_nothing(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    options = [*place.options[:-1], place.options[-1].replace("anna", "ben")]
    assert eventually(lambda: main(["look", "320", "240", "--yes", *options]) == 2)
    assert "does not answer 'ben': is that name in its link.pointers?" in capsys.readouterr().err
    assert place.autopilot.asked == 0


def test_a_place_has_as_many_digits_as_its_radius_gives_meaning_to() -> None:
    offer = Offer("ab", -35.1234567, 149.7654321, 612.36, 3.44, 1.26)
    assert in_words(offer) == (
        "look at -35.123457 149.765432, 612 m above sea level (90 % within 3.4 m; picture 1.3 s old)"
    )
    assert in_words(dataclasses.replace(offer, ce90_m=24.0)).startswith("look at -35.12346 149.76543, ")


def test_everybody_sees_who_had_the_camera_look_where(place: Place, capsys: pytest.CaptureFixture[str]) -> None:
    words = "anna: at -35.12346 149.76543, 612 m: accepted"
    status = VehicleStatus(time.time(), 1, "ok", looks=True, look=words)

    ended = threading.Event()

    def report() -> None:
        while not ended.wait(0.1):
            place.publisher.report(STATUS, encode_status(status))

    def is_shown(*form: str) -> bool:
        assert main(["watch", "--count", "2", *form, *place.options]) == 0
        return words in capsys.readouterr().out

    reporting = threading.Thread(target=report)
    reporting.start()
    try:
        assert eventually(is_shown)
        assert eventually(lambda: is_shown("--json"))
    finally:
        ended.set()
        reporting.join()
