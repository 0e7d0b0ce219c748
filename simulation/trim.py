"""`python -m simulation.trim`: cut a thinned piece out of a recording, its truth kept on the piece's own clock."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from contract.errors import InputError
from simulation import tlog
from simulation.flight import find_recording, least_delay_s
from simulation.trajectory import TRUTH_COLUMNS, RecordedTruth

# What replay needs, and every how manieth of it: attitude comes at 50 Hz and is kept at 25, GPS_RAW_INT at 10 and at 5.
KEEP_EVERY = {
    tlog.HEARTBEAT: 1,
    tlog.SYSTEM_TIME: 1,
    tlog.GPS_RAW_INT: 2,
    tlog.ATTITUDE: 2,
    tlog.GLOBAL_POSITION_INT: 1,
    tlog.EKF_STATUS_REPORT: 1,
    tlog.HOME_POSITION: 1,
}
LOG_MARGIN_S = 5.0


def trim(recording: str, start_s: float, seconds: float, out_stem: Path) -> None:
    """Write OUT.tlog and OUT.truth.csv: `seconds` from `start_s` after the truth's first row, the log 5 s wider.

    The boot clock drifts against the log's, so a piece's least delay is not the whole log's: the truth's times are
    moved by the difference and stay "boot time plus the least delay seen" for a reader of the piece.
    """
    log_path, truth_path = find_recording(recording)
    whole, truth = tlog.read(log_path), RecordedTruth.read(truth_path)
    begin = float(truth.unix_time_s[0]) + start_s
    part = truth.between(begin, begin + seconds)
    if start_s < 0.0 or begin + seconds > float(truth.unix_time_s[-1]):
        raise InputError(f"recording {recording} does not hold {seconds:g} s from {start_s:g} s on")
    piece = tlog.cut(whole, begin - LOG_MARGIN_S, begin + seconds + LOG_MARGIN_S, KEEP_EVERY)
    shift = least_delay_s(piece) - least_delay_s(whole)
    lines = [TRUTH_COLUMNS]
    for time, lat, lon, height, (roll, pitch, yaw) in zip(
        part.unix_time_s, part.lat_deg, part.lon_deg, part.height_amsl_m, part.roll_pitch_yaw_deg, strict=True
    ):
        place = f"{lat:.7f},{lon:.7f},{height:.2f}"
        lines.append(f"{time + shift:.4f},{place},{roll:.2f},{pitch:.2f},{yaw:.2f}")
    out_stem.with_name(out_stem.name + ".tlog").write_bytes(piece)
    out_stem.with_name(out_stem.name + ".truth.csv").write_text("\n".join(lines) + "\n")


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 written, 2 wrong usage or input."""
    parser = argparse.ArgumentParser(prog="python -m simulation.trim", description=__doc__.partition(": ")[2])
    parser.add_argument("recording", help="a name in ../shared/data/sitl, or a path")
    parser.add_argument("start", type=float, help="seconds after the truth's first row")
    parser.add_argument("seconds", type=float)
    parser.add_argument("out", type=Path, help="path without ending; .tlog and .truth.csv are added")
    options = parser.parse_args(arguments)
    try:
        trim(options.recording, options.start, options.seconds, options.out)
    except (InputError, OSError) as error:
        print(f"simulation.trim: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
