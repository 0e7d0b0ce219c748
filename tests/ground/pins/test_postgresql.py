"""Pins in a PostgreSQL server: what is its own. That it stores as a file does is in test_store.py."""

import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from contract.errors import InputError
from ground.__main__ import main
from ground.pins.sharing import PinSharing
from ground.pins.store import PinStore
from tests import postgres
from tests.ground.pins.test_sharing import same
from tests.ground.pins.test_store import clicked, typed
from tests.onboard.link.ports import free_endpoint

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def url(postgresql: postgres.Server) -> str:
    return postgresql.database()


def rows(url: str, statement: str) -> list[tuple[Any, ...]]:
    import psycopg  # noqa: PLC0415  only where there is a server

    with psycopg.connect(url) as db:
        found = db.execute(statement)
        return found.fetchall() if found.description else []


def test_a_server_that_was_gone_is_reported_in_a_line_and_found_again(url: str, postgresql: postgres.Server) -> None:
    with PinStore(url) as store:
        pin = store.add([typed()], name="before")
        postgresql.stop()
        try:
            with pytest.raises(InputError, match="pins postgresql://") as refused:
                store.add([typed()], name="lost")
            assert "\n" not in str(refused.value) and "secret-word" not in str(refused.value)
            with pytest.raises(InputError):
                _ = store.revision
        finally:
            postgresql.start()
        assert store.pin(pin.id).name == "before" and [p.name for p in store.pins()] == ["before"]
        assert store.add([typed()], name="after").number == 2


def test_the_tables_stand_in_a_schema_of_their_own_and_anothers_are_left_alone(url: str) -> None:
    rows(url, "CREATE TABLE pins (x INTEGER)")
    with PinStore(url) as store:
        store.add([typed()])
    assert rows(url, "SELECT COUNT(*) FROM public.pins") == [(0,)]
    assert rows(url, "SELECT COUNT(*) FROM pointclick.pins") == [(1,)]
    rows(url, "UPDATE pointclick.meta SET value = 9 WHERE key = 'schema'")
    with pytest.raises(InputError, match="of version 9; this program reads 1"):
        PinStore(url)


def test_several_that_begin_at_once_on_an_empty_database_make_its_tables_once(url: str) -> None:
    stores: list[PinStore] = []
    threads = [threading.Thread(target=lambda: stores.append(PinStore(url))) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(stores) == 6
    for number, store in enumerate(stores, 1):
        assert store.add([typed()]).number == number
        store.close()
        with pytest.raises(InputError, match="closed"):
            store.pins()


def test_a_reader_does_not_wait_for_a_writer(url: str) -> None:
    with PinStore(url) as one, PinStore(url) as two:
        one.add([typed()], name="there")
        with one._file.writing():
            one._file.bump("revision")
            assert [p.name for p in two.pins()] == ["there"]


def test_a_user_that_may_only_read_and_write_rows_can_work_on_tables_that_are_there(url: str) -> None:
    PinStore(url).close()
    rows(url, "CREATE ROLE clerk LOGIN")
    rows(url, "GRANT USAGE ON SCHEMA pointclick TO clerk")
    rows(url, "GRANT SELECT, INSERT, UPDATE ON ALL TABLES IN SCHEMA pointclick TO clerk")
    try:
        with PinStore(url.replace("pins:secret-word@", "clerk@")) as store:
            pin = store.add([typed()], name="by a clerk")
            store.delete(pin.id)
            assert store.undo() is not None and len(store.pins()) == 1
    finally:
        rows(url, "DROP OWNED BY clerk")
        rows(url, "DROP ROLE clerk")


def test_a_store_in_a_server_is_shared_with_one_in_a_file(url: str, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with (
        PinStore(url) as ann,
        PinStore(tmp_path / "bob.sqlite") as bob,
        PinSharing(ann, listen=[endpoint]),
        PinSharing(bob, connect=[endpoint]),
    ):
        ann.add([clicked()], name="tent", who="ann")
        bob.add([typed()], name="smoke", who="bob")
        assert same(ann, bob)
        assert sorted(p.name for p in ann.pins()) == ["smoke", "tent"]


def test_the_commands_take_it(url: str, capsys: pytest.CaptureFixture[str]) -> None:
    at = ["--store", url, "--who", "ann"]
    assert main(["pins", "add", "--at", "-35.0,149.0", "--name", "tent", *at]) == 0
    capsys.readouterr()
    assert main(["pins", "list", "--format", "csv", *at]) == 0
    assert "tent" in capsys.readouterr().out
    with PinStore(url) as store:
        assert [p.who for p in store.pins()] == ["ann"] and "secret-word" not in store.name


def test_a_server_that_is_not_there_is_one_line_without_the_password(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nowhere = f"postgresql://ann:secret-word@/d?host={tmp_path}&password=secret-word"
    assert main(["pins", "list", "--store", nowhere]) == 2
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and "secret-word" not in printed and str(tmp_path) in printed


def test_without_the_extra_it_is_reported_what_to_install() -> None:
    program = (
        "import sys; sys.modules['psycopg'] = None\n"
        "from ground.__main__ import main\n"
        "sys.exit(main(['pins', 'list', '--store', 'postgresql://h/d']))"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "its extra [postgresql]" in done.stderr and done.stderr.count("\n") == 1
