"""A configuration in several files: `config.toml`, then `config.d/*.toml` next to it by name; later ones win."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.camera_files.formats import load_camera_file
from onboard.config.schema import Config, load_table

FOLDER = "config.d"


def config_files(path: Path) -> list[Path]:
    """The file and those that add to it, in the order in which they are read."""
    return [path, *sorted(p for p in (path.parent / FOLDER).glob("*.toml") if p.is_file())]


def load_config_files(path: Path | str) -> Config:
    """Read them all. Raises ConfigError, one line that names the file at fault, the key, and what would be right."""
    merged: dict[str, Any] = {}
    for file in config_files(Path(path)):
        table, _ = load_table(file)  # each must be valid by itself, so that the message names it
        _merge(merged, table)
    return Config.model_validate(merged)


def _merge(merged: dict[str, Any], later: dict[str, Any]) -> None:
    """Key by key, in sections within sections too."""
    for key, value in later.items():
        if isinstance(value, dict):
            _merge(merged.setdefault(key, {}), value)
        else:
            merged[key] = value


def state_folder(config: Config, environment: dict[str, str]) -> Path:
    """The folder of the daemon's estimates and recordings, made if absent. Raises ConfigError if it cannot be."""
    named = config.service.state_dir or environment.get("STATE_DIRECTORY", "").split(":")[0]
    folder = Path(named) if named else Path.home() / ".local" / "state" / "pointclick"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"state directory {folder}: {error.strerror}; set service.state_dir") from error
    return folder


def load_camera(config: Config) -> Camera:
    """The optics that `camera.file` names. Raises ConfigError if it names none, InputError for one that is no good."""
    if config.camera.file is None:
        raise ConfigError("camera.file is not set: name a camera file, as `pc-onboard calibrate` writes it")
    return load_camera_file(config.camera.file)


def load_second_camera(config: Config) -> Camera:
    """The optics that `camera.thermal.file` names. Raises ConfigError, InputError as `load_camera`."""
    second = config.camera.thermal
    if second.file is None:
        raise ConfigError(
            "camera.thermal.file is not set: name the second camera's file, as `pc-onboard calibrate` writes it"
        )
    if config.thermal.enabled:
        raise ConfigError(
            "camera.thermal is a second camera next to one that sees light, and thermal.enabled states that the first "
            "is a thermal one: leave one of them out"
        )
    return load_camera_file(second.file)
