"""V4L2 devices: which there are, what identifies each, and how to find one again under another number."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from onboard.camera.v4l2_device import Card

DEV = Path("/dev")
SYS = Path("/sys/class/video4linux")


@dataclass(frozen=True)
class Identity:
    """The identity of a camera that stays when it comes back: all that the kernel and udev know it by."""

    driver: str
    card: str
    bus_info: str
    names: frozenset[str] = frozenset()  # under /dev/v4l/by-id: vendor, model, serial number
    index: str = ""  # which of one camera's several devices

    def likeness(self, other: Identity) -> int:
        """0: another camera; more: the same make, the same plug (2), the same serial number (3)."""
        if (self.driver, self.card, self.index) != (other.driver, other.card, other.index):
            return 0
        if self.names and other.names:
            # Cameras without a serial number share a name, and the kernel gives it to one of them only.
            return 3 if self.names & other.names else 0
        return 2 if self.bus_info == other.bus_info else 1


def device_paths(dev: Path = DEV) -> list[str]:
    """/dev/video0, /dev/video1, ... in the order of their numbers."""
    nodes = [node for node in dev.glob("video*") if node.name[5:].isdigit()]
    return [str(node) for node in sorted(nodes, key=lambda node: int(node.name[5:]))]


def stable_names(path: str, dev: Path = DEV) -> dict[str, list[str]]:
    """Names of a device that survive a new number: {"by-id": [...], "by-path": [...]}, full paths."""
    try:
        target = Path(path).resolve(strict=True)
    except OSError:
        return {}
    found: dict[str, list[str]] = {}
    for kind in ("by-id", "by-path"):
        links = sorted((dev / "v4l" / kind).glob("*")) if (dev / "v4l" / kind).is_dir() else []
        names = [str(link) for link in links if link.resolve() == target]
        if names:
            found[kind] = names
    return found


def identity(path: str, card: Card, dev: Path = DEV, sys: Path = SYS) -> Identity:
    """Return the identity of the device at `path`."""
    try:
        index = (sys / Path(path).resolve().name / "index").read_text().strip()
    except OSError:
        index = ""
    return Identity(card.driver, card.card, card.bus_info, frozenset(stable_names(path, dev).get("by-id", [])), index)


def candidates(configured: str, dev: Path = DEV) -> list[str]:
    """Return the paths at which to look for a camera that has been open before, its own first."""
    return [configured, *(path for path in device_paths(dev) if Path(path) != Path(configured))]


def same_camera(known: Identity, found: Iterable[tuple[str, Identity]]) -> str | None:
    """The path of the camera among `found` that is most surely the known one; None if none is, or two may be."""
    likely: dict[str, int] = {}
    for path, other in found:
        real = str(Path(path).resolve())
        likely.setdefault(real, known.likeness(other))
    best = max(likely.values(), default=0)
    paths = [path for path, score in likely.items() if score == best]
    return paths[0] if best > 0 and len(paths) == 1 else None
