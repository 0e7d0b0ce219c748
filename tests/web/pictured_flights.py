"""Flights for the pictures of docs: a car that drives off below, and a fire with people near it in heat."""

from pathlib import Path

from contract.camera import Camera
from contract.errors import LinkError
from contract.track import StartTrack, TrackRequest
from ground.recording import Recording
from ground.web.recorded import RecordedSource
from simulation.flight import DescribedSpec
from simulation.heat_sources import Fire, HeatSource
from simulation.movers import MoverSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.thermal import ThermalSpec
from tests.scenarios.flights import simulated
from tests.web.served import onboard, replay

CAR = MoverSpec.car((-10.0, -34.0), 9.0, 20.0)
TRAFFIC = SessionSpec(
    DescribedSpec(PathSpec(speed_m_s=6.0, height_m=110.0, heading_deg=20.0), ordinary(4), seed=4),
    seconds=9.0,
    rate_hz=8.0,
    movers=(CAR, MoverSpec.car((14.0, 10.0), 0.0, 110.0), MoverSpec.person((-16.0, 4.0), 1.3, 250.0)),
)
HEAT = SessionSpec(
    DescribedSpec(PathSpec(speed_m_s=2.0, height_m=90.0, heading_deg=20.0), ordinary(5), seed=5),
    seconds=34.0,
    rate_hz=2.0,
    camera=Camera.from_field_of_view(640, 512, 50.0),
    thermal=ThermalSpec(
        contrast=0.5,
        sources=(
            HeatSource.person((24.0, 4.0)), HeatSource.person((-22.0, 10.0), speed_m_s=0.6),
            HeatSource.car((-18.0, -14.0)),
        ),
        fires=(Fire(((-4.0, -6.0), (8.0, 4.0)), rate_m_s=0.15, first_m=2.0),),
    ),
)  # fmt: skip


def traffic(folder: Path) -> Path:
    """The recording of the flight over a car."""
    out = folder / "traffic.mcap"
    replay(simulated(TRAFFIC), out)
    return out


def heat(folder: Path) -> Path:
    """The recording of a thermal camera's flight about a fire, with what was found in its pictures."""
    out = folder / "heat.mcap"
    replay(simulated(HEAT), out, "--spots")
    return out


class Followed(RecordedSource):
    """A recorded flight that follows what is clicked as the aircraft would have: through its pictures since."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._path = path

    def unfollowed(self, vehicle: str) -> str:
        return ""

    def follow(self, vehicle: str, request: TrackRequest) -> dict[str, object]:
        """Replay it with that click."""
        if not isinstance(request, StartTrack) or request.frame is None:
            raise LinkError("only what is clicked in a picture is followed here")
        out = self._path.with_name("followed.mcap")
        onboard("replay", self._path, "--track", f"{request.frame},{request.u_px},{request.v_px}", "--out", out)
        self.views.tracks.read(Recording(out), [vehicle])
        return {"track": 1, "frame": request.frame}
