"""The configuration: partial files, the commented default, and errors that teach."""

import tomllib
from functools import reduce
from pathlib import Path

import pytest

from contract.errors import ConfigError
from onboard.commands.imported_flight import settings_of
from onboard.config.schema import Config, default_toml, key_table, load_config, parse_config

DEFAULT_FILE = Path(__file__).parents[3] / "config.toml"


def test_the_default_file_is_the_text_the_models_give() -> None:
    assert DEFAULT_FILE.read_text() == default_toml(), "run: python -m onboard.config.schema > config.toml"


def test_the_default_file_equals_the_defaults() -> None:
    assert load_config(DEFAULT_FILE) == Config()


def test_every_key_occurs_in_the_default_file() -> None:
    table = tomllib.loads(DEFAULT_FILE.read_text())
    text = DEFAULT_FILE.read_text()
    for name, info in key_table().items():
        section, key = name.rsplit(".", 1)
        assert key in reduce(dict.__getitem__, section.split("."), table) or (
            info.default is None and f"\n# {key} =\n" in text
        ), name


def test_a_number_of_thousands_of_digits_is_refused_as_other_damage_is() -> None:
    with pytest.raises(ConfigError, match="not TOML: Exceeds the limit"):
        parse_config(f"[camera]\nrate_hz = {'9' * 5000}\n")
    assert settings_of([f"camera.rate_hz={'9' * 5000}"])["camera.rate_hz"].startswith('"999')  # a text: no number


def test_a_partial_file_leaves_everything_else_at_its_default() -> None:
    config = parse_config('[mount]\nyaw_deg = -90\n[solve]\nattitude = "none"\nvelocity = false\n')
    assert config.mount.yaw_deg == -90.0
    assert (config.solve.attitude, config.solve.velocity) == ("none", False)
    assert config.mount.pitch_deg == Config().mount.pitch_deg == -90.0
    assert config.gps == Config().gps


def test_an_empty_file_is_the_default() -> None:
    assert parse_config("") == Config()


def test_the_configuration_cannot_be_changed_afterwards() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().mount.yaw_deg = 3.0
