"""The installed version, as both programs print it."""

from __future__ import annotations

from importlib import metadata


def version_line(program: str) -> str:
    """A program's name and version; without one where the checkout is not installed."""
    try:
        return f"{program} {metadata.version('pointclick')}"
    except metadata.PackageNotFoundError:
        return f"{program} of a checkout that is not installed"
