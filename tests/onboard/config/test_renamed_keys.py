"""A configuration written for an earlier version still works, with a warning, alone and over several files."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from contract.errors import ConfigError
from onboard.config.files import load_config_files
from onboard.config.renamed_keys import RENAMED, with_present_names
from onboard.config.schema import key_table, parse_config


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_old_name_sets_the_key_and_is_warned_of(old: str, new: str, caplog: pytest.LogCaptureFixture) -> None:
    assert new in key_table()
    assert old not in key_table()
    (section, old_key), new_key = old.split("."), new.split(".")[1]
    with caplog.at_level(logging.WARNING):
        config = parse_config(f"[{section}]\n{old_key} = 7.5\n")
    assert getattr(getattr(config, section), new_key) == 7.5
    assert f"{old} is now called {new}" in caplog.text


def test_a_key_under_both_names_is_refused_with_the_name_to_keep() -> None:
    with pytest.raises(ConfigError, match=r"keep only gps\.correlation_time_s"):
        parse_config("[gps]\nwander_time_s = 60.0\ncorrelation_time_s = 30.0\n")


def test_a_later_file_wins_whichever_name_each_uses(tmp_path: Path) -> None:
    (tmp_path / "config.toml").write_text("[gps]\nwander_time_s = 60.0\n")
    (tmp_path / "config.d").mkdir()
    (tmp_path / "config.d" / "50.toml").write_text("[gps]\ncorrelation_time_s = 30.0\n")
    assert load_config_files(tmp_path / "config.toml").gps.correlation_time_s == 30.0


def test_the_table_that_was_read_is_left_as_it_was() -> None:
    table = {"gps": {"wander_time_s": 60.0}, "vehicle": {"id": "kiwi"}}
    assert with_present_names(table) == {"gps": {"correlation_time_s": 60.0}, "vehicle": {"id": "kiwi"}}
    assert table["gps"] == {"wander_time_s": 60.0}
