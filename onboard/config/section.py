"""The base of the configuration's sections: typed, frozen, every key with unit, range, default and meaning."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


def quantity(default: float | None, low: float, high: float, unit: str, meaning: str) -> Any:
    """A number with its range and unit (empty for a pure number). None as default: the key may be left unset."""
    return Field(default, ge=low, le=high, description=meaning, json_schema_extra={"unit": unit})


def choice(default: object, meaning: str) -> Any:
    """A switch, a name or a list: no unit and no range beyond its type."""
    return Field(default, description=meaning, strict=False if isinstance(default, tuple) else None)


class Section(BaseModel):
    """Base of every section: frozen, strict types (an integer may stand for a real), no unknown key, no nan."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)
