"""Keys of earlier versions under their present names: an aircraft's file of last year still works, with a warning."""

from __future__ import annotations

import logging
from typing import Any

from contract.errors import ConfigError

log = logging.getLogger("pointclick")

RENAMED = {
    "gps.sigma_wander_horizontal_m": "gps.sigma_correlated_horizontal_m",
    "gps.sigma_wander_vertical_m": "gps.sigma_correlated_vertical_m",
    "gps.wander_time_s": "gps.correlation_time_s",
    "solve.attitude_wander_time_s": "solve.attitude_correlation_time_s",
    "solve.relief_sigma_m": "solve.ground_roughness_sigma_m",
}


def with_present_names(table: dict[str, Any]) -> dict[str, Any]:
    """A TOML table with renamed keys under their present names, each with a warning; the input is not changed.

    Raises ConfigError, one line, where a file has a key under both names.
    """
    out = {name: dict(section) if isinstance(section, dict) else section for name, section in table.items()}
    for old, new in RENAMED.items():
        section_name, old_key = old.split(".")
        section, new_key = out.get(section_name), new.split(".")[1]
        if not isinstance(section, dict) or old_key not in section:
            continue
        if new_key in section:
            raise ConfigError(f"{old} and {new} are the same key, renamed: keep only {new}")
        section[new_key] = section.pop(old_key)
        log.warning("configuration: %s is now called %s; please rename it", old, new)
    return out
