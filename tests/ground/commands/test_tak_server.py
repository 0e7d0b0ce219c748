"""`pc-ground cot` to a TAK server that others wrote (taky), by certificates on both sides, and a watcher there."""

import itertools
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from ground.__main__ import main
from ground.pins.store import PinStore
from tests.ground.commands.cot_server import add_pins, issue, number_of, to
from tests.left_out import NO_PROGRAM
from tests.tak_server import Taky, Watcher, installed
from tests.waiting import PATIENCE_S, eventually

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("taky")]  # short: test_cot_outage.py, with a server of our own
PINS = 1000
MINUTES = 10  # at a hundredth: the command's period of 10 s is 0.1 s


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = installed(tmp_path_factory.mktemp("taky") / "venv")
    if found is None:
        pytest.skip(f"{NO_PROGRAM} taky; it comes from PyPI, which cannot be reached from here")
    return found


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return issue(tmp_path_factory.mktemp("keys"))


@pytest.fixture
def taky(python: Path, keys: Path, tmp_path: Path) -> Iterator[Taky]:
    (tmp_path / "server").mkdir()
    made = Taky(python, tmp_path / "server", keys)
    made.start()
    yield made
    made.kill()


@pytest.fixture
def watcher(taky: Taky, keys: Path) -> Iterator[Watcher]:
    made = Watcher(taky.port, keys)
    assert eventually(lambda: made.streams)
    yield made
    made.close()


def test_a_watcher_receives_what_was_sent_once(
    taky: Taky, watcher: Watcher, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A watcher of before received nothing, or all but the last: the sender's end made the server lose it."""
    with PinStore(tmp_path / "pins") as store:
        add_pins(store, range(3))
    send = ["--once", "--pins", str(tmp_path / "pins")]
    for times in range(1, 6):
        assert main([*to(keys, taky.port), *send]) == 0
        assert eventually(lambda times=times: len(watcher.events) >= 3 * times)
    assert Counter(map(number_of, watcher.events)) == Counter({0: 5, 1: 5, 2: 5})
    assert {event.get("type") for event in watcher.events} == {"b-m-p-s-m"}
    assert {event.find("point").get("ce") for event in watcher.events} == {"4.3"}
    capsys.readouterr()
    assert main([*to(keys, taky.port, keys / "elsewhere" / "stranger"), *send]) == 2
    assert "--to-certificate" in capsys.readouterr().err
    assert len(watcher.events) == 15


def test_a_thousand_pins_while_the_server_is_gone_are_all_known_once_it_is_back(
    taky: Taky, watcher: Watcher, keys: Path, tmp_path: Path
) -> None:
    """None lost, none doubled, and the command needs no more memory than for sending them."""
    with PinStore(tmp_path / "pins") as store:
        add_pins(store, range(1))
        program = subprocess.Popen(
            [sys.executable, "-m", "ground", *to(keys, taky.port), "--period", "0.1", "--pins", tmp_path / "pins"],
            cwd=Path(__file__).parents[3], stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            assert eventually(lambda: watcher.events)
            assert program.stderr is not None
            taky.kill()
            assert "events to" in program.stderr.readline()
            assert "cannot" in program.stderr.readline()
            before_bytes = resident_bytes(program.pid)
            for first, last in itertools.pairwise(range(1, PINS + 2, PINS // MINUTES)):
                add_pins(store, range(first, last))
            gone_bytes = resident_bytes(program.pid)
            received = len(watcher.events)
            taky.start()
            known: set[int] = set()
            assert eventually(
                lambda: known.update(map(number_of, watcher.events[received:])) or len(known) == PINS + 1,
                within_s=3 * PATIENCE_S,
            )
        finally:
            program.send_signal(signal.SIGINT)
            program.communicate(timeout=PATIENCE_S)
    assert known == set(range(PINS + 1))
    times = Counter((event.get("uid"), event.get("time")) for event in watcher.events)
    assert max(times.values()) == 1
    assert gone_bytes - before_bytes < 1_000_000


def resident_bytes(process: int) -> int:
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
