"""A configuration in several files."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.config.files import load_config_files, load_second_camera, state_folder
from onboard.config.schema import Config, parse_config, to_toml


@pytest.fixture
def etc(tmp_path: Path) -> Path:
    (tmp_path / "config.d").mkdir()
    (tmp_path / "config.toml").write_text('[vehicle]\nid = "kiwi"\n[camera]\nrate_hz = 10\ngain = 3\n')
    return tmp_path


def test_later_files_win_key_by_key_in_order_of_name(etc: Path) -> None:
    (etc / "config.d" / "20-camera.toml").write_text("[camera]\nrate_hz = 20\n")
    (etc / "config.d" / "10-camera.toml").write_text("[camera]\nrate_hz = 15\nfocus = 7\n")
    (etc / "config.d" / "30-link.toml.bak").write_text("not read")
    config = load_config_files(etc / "config.toml")
    assert (config.vehicle.id, config.camera.rate_hz, config.camera.gain, config.camera.focus) == ("kiwi", 20, 3, 7)


def test_a_section_within_a_section_is_added_to_key_by_key(etc: Path) -> None:
    (etc / "config.d" / "10.toml").write_text('[camera.thermal]\ndevice = "/dev/video9"\nyaw_deg = 3.0\n')
    (etc / "config.d" / "20.toml").write_text("[camera.thermal]\nyaw_deg = 4.0\n[camera]\nrate_hz = 15\n")
    config = load_config_files(etc / "config.toml")
    second = config.camera.thermal
    assert (second.device, second.yaw_deg, config.camera.rate_hz) == ("/dev/video9", 4.0, 15)
    assert parse_config(to_toml(config)) == config


def test_a_second_camera_needs_a_file_and_a_first_that_sees_light(tmp_path: Path) -> None:
    alone = parse_config('[camera.thermal]\ndevice = "/dev/video9"\n')
    with pytest.raises(ConfigError, match=r"camera\.thermal\.file is not set"):
        load_second_camera(alone)
    both = parse_config('[thermal]\nenabled = true\n[camera.thermal]\nfile = "thermal.json"\n')
    with pytest.raises(ConfigError, match=r"thermal\.enabled states that the first is a thermal one"):
        load_second_camera(both)
    (tmp_path / "thermal.json").write_text(Camera.from_field_of_view(160, 120, 57.0).to_json())
    good = parse_config(f'[camera.thermal]\nfile = "{tmp_path / "thermal.json"}"\nscale = 0.01\noffset = 1.0\n')
    assert load_second_camera(good).size_px == (160, 120)
    assert (good.heat.enabled, good.heat.scale, good.heat.offset) == (True, 0.01, 1.0)
    assert parse_config("").heat == parse_config("").thermal


def test_without_a_folder_the_file_is_all(tmp_path: Path) -> None:
    (tmp_path / "config.toml").write_text("[camera]\nrate_hz = 10\n")
    assert load_config_files(tmp_path / "config.toml").camera.rate_hz == 10


@given(
    st.text(max_size=40),
    st.floats(-180, 180),
    st.sampled_from(["auto", "always", "never"]),
    st.lists(st.text(max_size=10), max_size=3).map(tuple),
)
def test_what_differs_from_the_defaults_reads_back_the_same(
    device: str, roll: float, gimbal: str, listen: tuple[str, ...]
) -> None:
    table = {"camera": {"device": device}, "mount": {"roll_deg": roll, "gimbal": gimbal}, "link": {"listen": listen}}
    config = Config.model_validate(table)
    assert parse_config(to_toml(config)) == config
    assert to_toml(Config()) == ""


def test_the_state_folder_is_the_configured_one_else_systemds_else_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    configured = Config.model_validate({"service": {"state_dir": str(tmp_path / "a" / "b")}})
    environment = {"STATE_DIRECTORY": f"{tmp_path / 'c'}:{tmp_path / 'd'}"}
    assert state_folder(configured, environment) == tmp_path / "a" / "b"
    assert state_folder(Config(), environment) == tmp_path / "c"
    assert state_folder(Config(), {}) == tmp_path / ".local" / "state" / "pointclick"
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"service\.state_dir"):
        state_folder(Config.model_validate({"service": {"state_dir": str(tmp_path / "file" / "x")}}), {})
