"""What a test's source has of tracks and hot spots where none takes part: none, and no one follows."""

from typing import Any

from contract.errors import LinkError
from contract.feature_set import FeatureSet
from contract.look import LookRequest
from contract.track import TrackRequest
from ground.unmeasured import NOT_TRIED
from ground.web.source import Views


class Unfollowed:
    """A part of `Source`. Paths and spots are every such source's: nothing is put into them."""

    measures = False

    views = Views()

    def measured(self, feature_set: FeatureSet, uv_px: tuple[float, float]) -> FeatureSet:
        raise LinkError(NOT_TRIED)

    def unfollowed(self, vehicle: str) -> str:
        return f"aircraft {vehicle!r} does not answer"

    def follow(self, vehicle: str, request: TrackRequest) -> dict[str, object]:
        raise LinkError(self.unfollowed(vehicle))

    def unlooked(self, vehicle: str) -> str:
        return self.unfollowed(vehicle)

    def look(self, vehicle: str, request: LookRequest) -> dict[str, Any]:
        raise LinkError(self.unlooked(vehicle))
