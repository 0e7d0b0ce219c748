"""A configuration for others than its owner: recordings are passed on, and replayed without the addresses in them."""

from __future__ import annotations

from typing import Any

from contract.secrets import without_secrets
from onboard.config.schema import Config, to_toml


def recorded_toml(config: Config) -> str:
    return to_toml(Config.model_validate(_without_secrets(config.model_dump())))


def with_secrets_of(recorded: Config, own: Config) -> Config:
    """A recorded configuration with what was left out of it, as far as the aircraft's own one has it."""
    return Config.model_validate(_restored(recorded.model_dump(), own.model_dump()))


def _restored(recorded: Any, own: Any) -> Any:
    if isinstance(recorded, dict) and isinstance(own, dict):
        return {key: _restored(part, own.get(key)) for key, part in recorded.items()}
    return own if recorded == _without_secrets(own) else recorded


def _without_secrets(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_secrets(part) for key, part in value.items()}
    if isinstance(value, tuple):
        return tuple(_without_secrets(part) for part in value)
    return without_secrets(value) if isinstance(value, str) else value
