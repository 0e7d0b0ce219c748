"""Hot spots: what is hotter (or colder) than the ground about it in one picture. docs/wire-format.md, section 15."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import Enum

from contract.answer import CONFIDENCE, EXPLANATIONS, Place, rounded, time_utc
from contract.feature_set import Status

PERSON_K = 8.0  # above the ground, of a person who is looked for, as the camera sees it: through the air
PERSON_M2 = 0.25  # large, from above
PERSON_GRID = 4, 5  # rows and columns of the parts of a picture for which it is stated who has been named there
SURE_PICTURES = 2  # that report a thing, to name it: noise that looks hot once is not there again
LEAST_LIKELY = 0.01
MOST_SPOTS = 6  # that a packet holds, with room for outlines


class ThingKind(Enum):
    """The kind that a net takes a spot for; the wire has its place in this list, which grows at its end only."""

    PERSON = "person"
    VEHICLE = "vehicle"
    OTHER = "other"


@dataclass(frozen=True)
class Spot:
    """One spot. `u_px`, `v_px` is its middle, weighed by how hot its pixels are.

    `contrast` is how far it is above its ground (below: less than 0), in sigmas of how much that ground varies;
    `temperature_c` its hottest (coldest) pixel's temperature and `above_ground_k` how far that is from its ground's,
    None where the camera is not calibrated: both too small for a spot smaller than a pixel. Without a place `status`
    states why, in the words of a refused click, and there is neither area nor outline. `outline_en_m` is a polygon,
    east and north of the place, m; empty: not sent. `is_cut`: the picture's edge, or ground without an answer, cuts
    it, and there is more of it. `kind` is what a net takes it for (None: it is only hot), `log_odds` (ln) how likely
    that is by all looks at it.
    """

    u_px: float
    v_px: float
    contrast: float
    temperature_c: float | None = None
    above_ground_k: float | None = None
    status: Status = Status.STARTING
    place: Place | None = None
    area_m2: float = 0.0
    sigma_area_m2: float = 0.0
    outline_en_m: tuple[tuple[float, float], ...] = ()
    is_cut: bool = False
    kind: ThingKind | None = None
    log_odds: float = 0.0

    @property
    def probability(self) -> float | None:
        """The probability that it is of that `kind`; None for a spot that is only hot.

        From LEAST_LIKELY to 1 less that: no calibration holds enough things to state more.
        """
        most = math.log(1.0 / LEAST_LIKELY - 1.0)
        return None if self.kind is None else 1.0 / (1.0 + math.exp(-min(max(self.log_odds, -most), most)))

    def to_dict(self) -> dict[str, object]:
        """Return the JSON object; figures of the place only if it is known."""
        content: dict[str, object] = {
            "u": round(self.u_px, 2), "v": round(self.v_px, 2), "contrast": round(self.contrast, 2),
            "temperature_c": rounded(self.temperature_c), "above_ground_k": rounded(self.above_ground_k),
            "is_cut": self.is_cut, "status": self.status.value,
            "kind": None if self.kind is None else self.kind.value, "probability": rounded(self.probability),
        }  # fmt: skip
        if self.place is not None:
            content |= self.place.to_dict()
            content |= {
                "area_m2": rounded(self.area_m2), "sigma_area_m2": rounded(self.sigma_area_m2),
                "outline_en_m": [[round(east, 3), round(north, 3)] for east, north in self.outline_en_m],
            }  # fmt: skip
        return content

    def to_text(self) -> str:
        """One line for people."""
        p = self.place
        how = likely_text(self.kind, self.probability)
        if self.temperature_c is not None and self.above_ground_k is not None:
            how += f"{self.temperature_c:.1f} degC, {self.above_ground_k:+.1f} K, "
        how += f"{abs(self.contrast):.1f} sigmas {'colder' if self.contrast < 0.0 else 'hotter'} than its ground"
        if p is None:
            return f"{how}  {self.status.value}: {EXPLANATIONS[self.status]}"
        e = p.ellipse
        return (
            f"{how}  {e.rounded(p.lat_deg, p.lon_deg)}  {CONFIDENCE:.0%} ellipse {e.semi_major_m:.1f} x "
            f"{e.semi_minor_m:.1f} m at {e.azimuth_deg:.0f} deg  {self.area_m2:.2g} +-{self.sigma_area_m2:.1g} m2"
        )


def likely_text(kind: ThingKind | None, probability: float | None) -> str:
    """Return the kind that a net takes a spot for and how likely that is, in words; empty if it is only hot."""
    if kind is None or probability is None:
        return ""
    word = {ThingKind.OTHER: "another thing"}.get(kind, f"a {kind.value}")
    return f"{word}, {round(100.0 * probability)} % likely, "


def person_text(share: float) -> str:
    """On how much of the ground in view a person would be found, for people."""
    return f"a person ({PERSON_K:g} K warmer) would be found on {math.floor(100.0 * share)} % of the ground in view"


@dataclass(frozen=True)
class SpotReport:
    """All spots of a picture, the most significant first (of many: those whose turn it is); `more` were found and
    are not in the report.

    `picture_share` and `session_share` are shares of the spots' horizontal variance: what all spots of this picture
    have in common, and what (of that) those of the session's other pictures have too. The first does not become less by
    the picture's other spots, the second not by other pictures of the same spot. `person_found` is the share of the
    picture's ground on which a person, PERSON_K warmer than it, would be found in this picture; `person_named` of each
    part of the picture, PERSON_GRID row by row, that on which he would have been named by now, by all of the session's
    reports: None of a part that shows no ground. None and empty where it is not known.
    """

    session: int
    frame: int
    capture_unix_ns: int
    is_calibrated: bool
    spots: tuple[Spot, ...] = ()
    more: int = 0
    picture_share: float = 0.0
    session_share: float = 0.0
    vehicle: str = ""
    person_found: float | None = None
    person_named: tuple[float | None, ...] = ()

    def to_json(self) -> str:
        return json.dumps(
            {
                "vehicle": self.vehicle or None, "frame": self.frame, "time_utc": time_utc(self.capture_unix_ns),
                "is_calibrated": self.is_calibrated,
                "picture_share": rounded(self.picture_share), "session_share": rounded(self.session_share),
                "person_found": rounded(self.person_found), "person_named": [rounded(p) for p in self.person_named],
                "more": self.more,
                "spots": [spot.to_dict() for spot in self.spots],
            }
        )  # fmt: skip

    def to_text(self) -> str:
        """A line for people, and one for each spot."""
        count = f"{len(self.spots)} spots" if len(self.spots) != 1 else "1 spot"
        more = f" and {self.more} more" if self.more else ""
        scale = "" if self.is_calibrated else ", uncalibrated"
        scale += "" if self.person_found is None else f", {person_text(self.person_found)}"
        head = f"{count}{more}{scale}  frame {self.frame} at {time_utc(self.capture_unix_ns)}"
        return "\n  ".join([head, *(spot.to_text() for spot in self.spots)])
