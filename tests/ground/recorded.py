"""Sets as a recording, each with the picture that it is of."""

from collections.abc import Iterable
from pathlib import Path

from contract.feature_set import FeatureSet
from onboard.events.types import Frame
from onboard.storage.mcap_writer import SessionRecorder


def record(path: Path, sets: Iterable[FeatureSet]) -> str:
    with SessionRecorder(path, "uav-1") as out:
        for s in sets:
            out.write_event(Frame(s.capture_unix_ns, s.frame, None, f"picture_{s.frame}.png"))
            out.write_set(s)
    return str(path)
