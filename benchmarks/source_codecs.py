"""What compression costs: a flight's clicks on its own pictures next to those on what a codec has left of them.

    python -m benchmarks.source_codecs [--size 1280x720] [--seconds 16] [--rate 5] [--kbit 1000,2000,4000,8000]
        [--codecs H264] [--loss 0] [--seeds 1,2] [--autopilots 8]

One path for each seed, with turns over relief, its pictures encoded (OpenH264; x265 at its fastest), sent as RTP
packets of 1400 bytes of which `--loss` never come (0: as over TCP), and decoded by libav; then the flight is replayed
with what has come. A picture that the decoder or our helper calls damaged, or that never came, has no image. Telemetry
and stamps are the flight's own in every row: what a stream does to times is `benchmarks.sources`. Each path's pictures
are replayed with several autopilots' telemetry (`simulation.ordinary`), for each of which they are one flight: its
mount, stamps and camera file are stated wrongly by errors sampled from the sigmas that are stated with them.

`--kbit` are those of 30 pictures a second: a flight of fewer gets as many bits a picture, though more has moved between
two of them. An encoder that cannot go so low is seen by the rate that it did send. Clicks count after the first 8 s.
A flight's clicks share its slow errors, of which one autopilot is one sample. So absolute coverage is the mean of the
flights', with the sigma of that mean by how they scatter, and with it what is added to or taken from the raw
pictures' coverage, flight by flight: the slow errors are the same there, and only what pictures do is left. It shows
too in the distance between two clicks of one picture, where slow errors cancel: its error, and how often its own 90 %
ellipse holds it.
Processor: the decoder's, a picture.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scatter import mean_and_sigma
from benchmarks.sources import cells, flight_spec
from contract.answer import Fix
from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.locate import Locator
from onboard.config.files import load_config_files
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight, replay
from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.session import SessionSpec, make_flight
from simulation.telemetry import write_tlog
from tests.rtsp import SYSTEM_PYTHON, is_installed
from tests.scenarios.flights import CHI2_90, Outcome, _Sets, click, simulated
from tests.streamed_flight import pictures_of

RECODING = Path(__file__).resolve().parents[1] / "tests" / "recoding.py"
SETTLED_S = 8.0
OF_HZ = 30.0
FIELD_DEG = 60.0
MOUNT_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


@dataclass(frozen=True, eq=False)
class Recoded:
    """The decoded pictures of a flight, by number; kbit/s sent, as of OF_HZ; the decoder's time for a picture."""

    images: dict[int, NDArray[np.uint8]]
    sent_kbit: float
    decode_ms: float


class Received(Pipeline):
    """The pipeline of a flight of which these pictures have come; None: as they were taken."""

    images: dict[int, NDArray[np.uint8]] | None = None

    def handle(self, event: Event) -> list[FeatureSet]:
        """Pass the event on with the picture that was decoded, if there are any."""
        if isinstance(event, Frame) and self.images is not None:
            event = replace(event, image=self.images.get(event.index))
        return super().handle(event)


def recoded(raw: Path, size_px: tuple[int, int], count: int, rate_hz: float, **stream: object) -> Recoded:
    """Raw pictures through encoder, network and decoder."""
    with TemporaryDirectory() as name:
        out = Path(name) / "out.raw"
        bits = round(float(str(stream["kbit"])) * 1000.0 * rate_hz / OF_HZ)
        spec = {"frames": str(raw), "out": str(out), "width": size_px[0], "height": size_px[1], "rate_hz": rate_hz,
                "bit_rate": bits, "codec": stream["codec"], "loss": stream["loss"]}  # fmt: skip
        line = json.dumps(spec) + "\n"
        done = subprocess.run(
            [SYSTEM_PYTHON, "-I", str(RECODING)], input=line, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise InputError(f"{stream}: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
        said = json.loads(done.stdout)
        images = np.fromfile(out, np.uint8).reshape(-1, size_px[1], size_px[0])
    by_number = {k: image for k, image in zip(said["numbers"], images, strict=True) if k < count}
    return Recoded(by_number, 8e-3 * said["bytes"] / count * OF_HZ, 1e3 * said["decode_s"] / count)


def simulated_by(session: Path, spec: SessionSpec, autopilot: int, folder: Path) -> Path:
    """The session of a described flight as another autopilot would have logged it; pictures and truth are the same."""
    assert isinstance(spec.flight, DescribedSpec)
    flight = make_flight(spec)
    log, epoch_unix_s = write_tlog(
        flight.trajectory, flight.origin, flight.undulation_m, ordinary(autopilot), autopilot
    )
    copy = folder / f"{session.name}-{autopilot}"
    copy.mkdir()
    for path in session.iterdir():
        (copy / path.name).symlink_to(path)
    lines = ["file,unix_time_s"]
    for k, path in enumerate(sorted((session / "frames").iterdir())):
        lines.append(f"{path.name},{epoch_unix_s + flight.start_s + k / spec.rate_hz:.6f}")
    for name, data in (("telemetry.tlog", log), ("stamps.csv", "\n".join([*lines, ""]).encode())):
        (copy / name).unlink()
        (copy / name).write_bytes(data)
    return copy


def misstated(config: Config, camera: Camera, seed: int) -> tuple[Config, Camera]:
    """Mount, stamps and optics as somebody would state them who knows them as well as the stated sigmas say."""
    normal = np.random.default_rng([seed, 7]).normal
    mount, source = config.mount, config.camera
    angles = {name: getattr(mount, name) + normal(0.0, mount.sigma_deg) for name in MOUNT_ANGLES}
    late_s = source.latency_s + normal(0.0, source.sigma_latency_s)
    changed = {
        "mount": mount.model_copy(update=angles),
        "camera": source.model_copy(update={"latency_s": late_s}),
    }
    longer, right, down, k1, k2 = normal(0.0, camera.sigma)
    f = camera.fx_px
    optics = replace(
        camera, fx_px=f * (1.0 + longer), fy_px=camera.fy_px * (1.0 + longer), cx_px=camera.cx_px + f * right,
        cy_px=camera.cy_px + f * down, stated_sigma=camera.sigma,
        distortion=(camera.distortion[0] + k1, camera.distortion[1] + k2, *camera.distortion[2:]),
    )  # fmt: skip
    return config.model_copy(update=changed), optics


def outcome(session: Path, rate_hz: float, images: dict[int, NDArray[np.uint8]] | None, seed: int) -> Outcome:
    """Replay a session with these pictures, misstated by `seed`, and click."""
    exact = load_config_files(session / "config.toml"), Camera.from_json(session / "camera.json")
    config, camera = misstated(*exact, seed)
    flight = Flight.open(config, camera, session / "frames", session / "telemetry.tlog", session / "stamps.csv")
    pipeline, sink = Received(config, camera), _Sets()
    pipeline.images = images
    replay(flight, pipeline, [sink])
    return click(session, {k: s for k, s in sink.by_frame.items() if k >= SETTLED_S * rate_hz}, pipeline)


def between_clicks(session: Path, done: Outcome) -> tuple[list[float], list[float]]:
    """Errors (m) of the horizontal vectors between successive clicks of a picture; squares over covariances."""
    errors, chi2 = [], []
    by_frame: dict[int, list[dict[str, str]]] = {}
    with (session / "truth_clicks.csv").open(newline="") as file:
        for click_row in csv.DictReader(file):
            by_frame.setdefault(int(click_row["frame"]), []).append(click_row)
    for frame, clicks in by_frame.items():
        if frame not in done.sets:
            continue
        locator = Locator(done.sets[frame])
        for one, other in pairwise(clicks):
            at = [(float(c["u"]), float(c["v"])) for c in (one, other)]
            first, second, covariance = *map(locator.locate, at), locator.difference_covariance(*at)
            if covariance is None or not isinstance(first, Fix) or not isinstance(second, Fix):
                continue
            begin, end = (tuple(float(c[k]) for k in ("lat_deg", "lon_deg", "height_amsl_m")) for c in (one, other))
            error = (second.offset_enu_m - first.offset_enu_m - LocalFrame(*begin).to_enu(*end))[:2]
            errors.append(float(np.hypot(*error)))
            chi2.append(float(error @ np.linalg.solve(covariance[:2, :2], error)))
    return errors, chi2


def share_inside(done: Outcome) -> float:
    """The share of a flight's answered clicks inside their own 90 % ellipses; nan without any."""
    return float(np.mean(done.chi2 < CHI2_90)) if len(done.chi2) else float("nan")


def mean_with_sigma(shares: Sequence[float], sign: str = "") -> str:
    """Mean of flights, in percent, with its sigma by how they scatter; flights without answers are left out."""
    mean, sigma = mean_and_sigma([100.0 * share for share in shares if np.isfinite(share)])
    if np.isnan(mean):
        return "-"
    return f"{mean:{sign}.1f}" + ("" if np.isnan(sigma) else f" +-{sigma:.1f}") + " %"


def row(what: Sequence[str], sessions: Sequence[Path], outcomes: Sequence[Outcome], raw: Sequence[Outcome]) -> str:
    """A line of the table; `raw`: what came of the same flights on their own pictures."""
    stated = [between_clicks(session, done) for session, done in zip(sessions, outcomes, strict=True)]
    errors_m, chi2 = (np.concatenate([pair[k] for pair in stated]) for k in (0, 1))
    between = f"{np.median(errors_m):.2f} m | {100.0 * np.mean(chi2 < CHI2_90):.0f} %" if len(errors_m) else "- | -"
    pipelines = [o.pipeline for o in outcomes if o.pipeline is not None]
    pixel_px = np.mean([p.summary.reprojection_px for p in pipelines])
    standing = np.mean([p.summary.left_out.standing for p in pipelines])
    inside = [share_inside(done) for done in outcomes]
    difference = [ours - theirs for ours, theirs in zip(inside, map(share_inside, raw), strict=True)]
    by_flight = f"{mean_with_sigma(inside)} | {mean_with_sigma(difference, '+') if outcomes is not raw else '-'}"
    shown = f"{pixel_px:.2f} px | {100.0 * standing:.1f} % | {between} | {by_flight} | {cells(outcomes)}"
    return f"| {' | '.join(what)} | {shown} |"


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--seconds", type=float, default=16.0)
    parser.add_argument("--rate", type=float, default=5.0, help="Hz")
    parser.add_argument("--kbit", default="1000,2000,4000,8000", help="kbit/s")
    parser.add_argument("--codecs", default="H264")
    parser.add_argument("--loss", default="0", help="shares of the packets")
    parser.add_argument("--seeds", default="1,2", help="of the paths")
    parser.add_argument("--autopilots", type=int, default=8, help="that fly each path")
    arguments = parser.parse_args(argv)
    if not is_installed():
        parser.error("GStreamer is not installed: make gstreamer")
    width, height = (int(word) for word in arguments.size.split("x"))
    camera = Camera.from_field_of_view(width, height, FIELD_DEG)
    seeds = [int(word) for word in arguments.seeds.split(",")]
    specs = [replace(flight_spec(arguments.seconds, seed), camera=camera, rate_hz=arguments.rate) for seed in seeds]
    print(
        f"{len(seeds)} path(s) of {arguments.seconds:g} s with turns, each recorded by {arguments.autopilots} "
        f"autopilot(s), {arguments.size} at {arguments.rate:g} Hz\n"
    )
    print(
        "| pictures | sent, of 30 a second | decoder | came whole | residual | stands still | between clicks: median "
        "| inside 90 % | absolute: inside 90 %, flight by flight | beside raw | median | 90 % | inside 90 % "
        "| pictures answered | clicks answered |"
    )
    print("|" + 15 * "---|")
    words = (arguments.codecs.split(","), arguments.loss.split(","), arguments.kbit.split(","))
    streams = [{"codec": c, "loss": float(x), "kbit": float(k)} for c, x, k in product(*words)]
    with TemporaryDirectory() as name:
        table(specs, arguments.autopilots, streams, Path(name))


def table(specs: Sequence[SessionSpec], autopilots: int, streams: Sequence[dict[str, Any]], folder: Path) -> None:
    """Print a row for the raw pictures and for each stream, of all paths by all autopilots."""
    paths = [simulated(spec) for spec in specs]
    flights = [
        [simulated_by(path, spec, 100 * k + n, folder) for n in range(autopilots)]
        for k, (path, spec) in enumerate(zip(paths, specs, strict=True))
    ]
    sessions, rate_hz, size_px = [s for by in flights for s in by], specs[0].rate_hz, specs[0].camera.size_px
    plain = [outcome(session, rate_hz, None, seed) for seed, session in enumerate(sessions)]
    print(row(("raw", "-", "-", "100 %"), sessions, plain, plain), flush=True)
    for path in paths:
        pictures = pictures_of(path, False)
        (folder / f"{path.name}.raw").write_bytes(b"".join(picture.tobytes() for picture in pictures))
    count = len(pictures)
    for stream in streams:
        came = [recoded(folder / f"{path.name}.raw", size_px, count, rate_hz, **stream) for path in paths]
        images = [c.images for by, c in zip(flights, came, strict=True) for _ in by]
        pairs = enumerate(zip(sessions, images, strict=True))
        outcomes = [outcome(session, rate_hz, these, seed) for seed, (session, these) in pairs]
        whole = np.mean([len(c.images) for c in came]) / count
        over = f"UDP, {100.0 * stream['loss']:g} % lost" if stream["loss"] else "TCP"
        how = f"{stream['codec']}, {stream['kbit']:g} kbit/s, {over}"
        sent = f"{np.mean([c.sent_kbit for c in came]):.0f} kbit/s"
        decode = f"{np.mean([c.decode_ms for c in came]):.1f} ms"
        print(row((how, sent, decode, f"{100.0 * whole:.0f} %"), sessions, outcomes, plain), flush=True)


if __name__ == "__main__":
    main()
