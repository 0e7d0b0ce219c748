"""The configuration: partial files, the commented default, and errors that teach."""

import tomllib
from functools import reduce
from pathlib import Path

import pytest

from contract.errors import ConfigError
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


def test_a_partial_file_leaves_everything_else_at_its_default() -> None:
    config = parse_config('[mount]\nyaw_deg = -90\n[solve]\nattitude = "none"\nvelocity = false\n')
    assert config.mount.yaw_deg == -90.0
    assert (config.solve.attitude, config.solve.velocity) == ("none", False)
    assert config.mount.pitch_deg == Config().mount.pitch_deg == -90.0
    assert config.gps == Config().gps


def test_an_empty_file_is_the_default() -> None:
    assert parse_config("") == Config()


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("[mount]\nyaw = 90", "unknown key 'mount.yaw'; did you mean 'mount.yaw_deg'?"),
        ("[solve]\natitude = 'none'", "did you mean 'solve.attitude'?"),
        ("[gps]\nvelocity = true", "did you mean 'solve.velocity'?"),
        (
            "[camera.thermal]\nrol_deg = 1",
            "unknown key 'camera.thermal.rol_deg'; did you mean 'camera.thermal.roll_deg'?",
        ),
        ("[camera.thermal]\npitch_deg = 100", "camera.thermal.pitch_deg = 100 is not usable: -90 to 90 deg"),
        ("[camera.thermal]\nformat = 'Y17'", "camera.thermal.format = 'Y17' is not usable"),
        ("[camera]\nthermal = 3", "'camera.thermal' is a section"),
        ("[camera.termal]\nscale = 0.01", "did you mean 'camera.thermal'?"),
        ("yaw_deg = 90", "did you mean 'mount.yaw_deg'?"),
        ("[camera]\nurl = 'x'", "unknown key 'camera.url'; did you mean 'telemetry.url'?"),
        ("[mount]\nYaw_Deg = 3", "did you mean 'mount.yaw_deg'?"),
        ("[mount]\nzoom = 3", "unknown key 'mount.zoom'; known sections: "),  # no other word is near
        ("[muont]\nyaw_deg = 90", "unknown section 'muont'; did you mean 'mount'?"),
        ("[mount]\nyaw_deg = 400", "mount.yaw_deg = 400 is not usable: -360 to 360 deg"),
        ("[tracking]\nfeatures = 500", "tracking.features = 500 is not usable: a whole number from 20 to 200"),
        ("[gps]\nmax_gap_s = nan", "0.1 to 10 s"),
        ("[mount]\nroll_deg = '3'", "-180 to 180 deg"),
        ("[mount]\nroll_deg = true", "-180 to 180 deg"),
        ("[solve]\nvelocity = 1", "true or false"),
        ("[solve]\nattitude = 'gimbal'", '"none" or "autopilot"'),
        ("[vehicle]\nid = 'a/b'", "vehicle.id = 'a/b'"),
        ("mount = 3", "'mount' is a section"),
        ("[mount\n", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line_that_says_what_is_right(text: str, reported: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config(text)
    assert reported in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nothing\.toml: No such file .*; write one \(every key has a default\)"):
        load_config(tmp_path / "nothing.toml")


def test_a_binary_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not UTF-8"):
        load_config(tmp_path / "c.toml")


def test_the_configuration_cannot_be_changed_afterwards() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Config().mount.yaw_deg = 3.0  # type: ignore[misc]
