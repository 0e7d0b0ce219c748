"""Whether the service's user may read a file is judged for that user, whoever asks."""

import os
from pathlib import Path

import pytest

from onboard.service.readable import Reader

OTHER = Reader("pointclick", os.geteuid() + 4000, frozenset({os.getegid() + 4000}))
IN_GROUP = Reader("pointclick", os.geteuid() + 4000, frozenset({os.getegid()}))


@pytest.fixture
def key(tmp_path: Path) -> Path:
    """In folders that all may enter, as /etc is; pytest's own are closed."""
    folder = tmp_path / "keys"
    folder.mkdir()
    (folder / "key.pem").write_text("x")
    for place in (folder, *folder.parents):
        if place.stat().st_uid == os.geteuid() and not place.stat().st_mode & 0o001:
            place.chmod(place.stat().st_mode | 0o011)
    return folder / "key.pem"


@pytest.mark.parametrize(
    ("folder", "file", "reader", "reported"),
    [
        (0o755, 0o644, OTHER, ""),
        (0o755, 0o600, OTHER, "may not read it: chgrp pointclick"),
        (0o755, 0o640, OTHER, "the service's user pointclick may not read it"),
        (0o755, 0o640, IN_GROUP, ""),
        (0o700, 0o644, IN_GROUP, "may not enter"),
        (0o750, 0o640, IN_GROUP, ""),
    ],
)
def test_mode_and_group_decide(key: Path, folder: int, file: int, reader: Reader, reported: str) -> None:
    key.chmod(file)
    key.parent.chmod(folder)
    found = reader.complaint(key)
    assert reported in found and bool(found) == bool(reported)


def test_a_missing_file_is_reported_and_root_reads_everything(key: Path) -> None:
    assert "No such file" in OTHER.complaint(key.with_name("none.pem"))
    key.chmod(0o000)
    assert Reader("", 0, frozenset()).complaint(key) == ""
