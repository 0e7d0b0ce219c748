"""The flights that the scenarios are rendered of, small and few pictures of them."""

from dataclasses import replace

from contract.camera import Camera
from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.telemetry import TelemetrySpec
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from simulation.thermal import ThermalSpec
from tests.scenarios.flights import CAMERA

LEG = SessionSpec(DescribedSpec(PathSpec("straight")), seconds=8.0, rate_hz=3.0, camera=CAMERA, clicks_per_frame=6)
LARGE = replace(LEG, camera=Camera.from_field_of_view(640, 480, 40.0), rate_hz=5.0, seconds=7.0)
LOW = DescribedSpec(PathSpec("straight", height_m=100.0, speed_m_s=12.0))
FAST = DescribedSpec(PathSpec("straight", speed_m_s=35.0))
HOVER = replace(LEG, flight=DescribedSpec(PathSpec("hover", height_m=100.0)), rate_hz=2.0, seconds=9.0)
# Yaw at 0.2 rad/s within a circle of one metre.
ROTATION = replace(HOVER, flight=DescribedSpec(PathSpec("orbit", height_m=100.0, speed_m_s=0.1, radius_m=0.5)))
LOW_HOVER = replace(HOVER, flight=DescribedSpec(PathSpec("hover", height_m=20.0)), seconds=14.0)
WIDE = Camera.from_field_of_view(320, 240, 70.0)


def over(style: str, spec: SessionSpec = LEG, seed: int = 0, **texture: float) -> SessionSpec:
    """A flight over another ground."""
    return replace(spec, seed=seed, texture=TextureSpec(style, seed=seed, **texture))


def along(path: PathSpec, telemetry: TelemetrySpec | None = None, **changes: object) -> SessionSpec:
    """A leg along another path, or with other telemetry."""
    flight = DescribedSpec(path) if telemetry is None else DescribedSpec(path, telemetry)
    return replace(LEG, flight=flight, **changes)


def apart(apart_s: float, pictures: int = 12, speed_m_s: float = 12.0, height_m: float = 300.0) -> SessionSpec:
    """A straight leg with slow pictures; ten seconds apart at 12 m/s and 300 m, they have 62 % in common."""
    path = PathSpec("straight", speed_m_s=speed_m_s, height_m=height_m)
    return SessionSpec(
        DescribedSpec(path), seconds=pictures * apart_s, rate_hz=1.0 / apart_s, camera=WIDE, clicks_per_frame=8
    )


def ordinary_turns(seed: int, seconds: float) -> SessionSpec:
    """Legs joined by turns of 25 degrees, by an autopilot whose errors are not the declared ones."""
    flight = DescribedSpec(PathSpec("turns", leg_m=250.0), ordinary(seed), seed=seed)
    return SessionSpec(flight, seconds=seconds, rate_hz=2.0, camera=CAMERA, clicks_per_frame=6, seed=seed)


def photographs(seed: int) -> SessionSpec:
    """A survey with a photograph each 1.4 s."""
    path = PathSpec("survey", speed_m_s=14.0, height_m=150.0, wobble_deg=1.0, leg_m=150.0, spacing_m=60.0)
    flight = DescribedSpec(path, seed=seed)
    return SessionSpec(flight, seconds=28.0, rate_hz=1 / 1.4, camera=WIDE, clicks_per_frame=8, seed=seed)


# A Lepton: bland ground, a strong fixed pattern, and a shutter that closes for 0.4 s.
LEPTON = SessionSpec(
    DescribedSpec(PathSpec("turns", height_m=100.0, speed_m_s=12.0, leg_m=150.0), seed=5),
    seconds=14.0,
    rate_hz=8.0,
    camera=Camera.from_field_of_view(160, 120, 57.0),
    terrain=TerrainSpec(relief_m=6.0),
    texture=TextureSpec(seed=5),
    thermal=ThermalSpec(pattern_k=0.3, shutter_s=(7.0,), freeze_s=0.4),
)
