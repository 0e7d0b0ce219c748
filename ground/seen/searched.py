"""The probability of detection of each sector, and the gaps that are left: values, words and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from contract.spot import PERSON_K
from ground.seen.area import Sector
from ground.seen.coverage import Coverage, Gap, gaps
from ground.seen.detection import Detection, SectorDetection, sector_detection

BELOW = 0.5  # of a probability: a gap, if no other is asked for
# What the probabilities by each take for granted, for people.
ASSUMED = {
    "machine": f"by the search for heat: a person {PERSON_K:g} K warmer than the ground, half a metre across, "
    "in the open",
    "operator": "by whoever looks at each picture: a person half a metre across, by resolution and time alone; "
    "declared, not measured",
}


@dataclass(frozen=True, eq=False)
class Searched:
    """`gaps` are the parts of the searched area where the probability of detection by `who` is less than `below`."""

    detection: Detection
    sectors: list[SectorDetection]
    who: str
    below: float
    gaps: list[Gap]

    @classmethod
    def of(
        cls, by: Detection, over: Coverage, sectors: Sequence[Sector] | None, who: str | None, below: float
    ) -> Searched:
        """By `who`, or where that is None by the machine if it has searched. Raises InputError for an empty sector."""
        who = who or ("operator" if by.machine is None else "machine")
        found = by.of(who)
        mask = over.searched.copy()
        if found is not None:
            mask &= found[0] < below
        named = [(sector.name, sector.polygons) for sector in sectors] if sectors else [("", None)]
        each = [sector_detection(name, polygons, over, by, below) for name, polygons in named]
        return cls(by, each, who, below, gaps(over.cells, over.row0, over.column0, mask))

    def to_dict(self) -> dict[str, object]:
        """Return the JSON object."""
        by = self.detection
        return {
            "pictures": by.pictures, "searched_pictures": by.searched, "unmatched_reports": by.strangers,
            "by": self.who, "assumed": ASSUMED, "below": self.below,
            "sectors": [sector.to_dict() for sector in self.sectors],
            "gaps": [gap_dict(gap) for gap in self.gaps],
        }  # fmt: skip

    def to_text(self) -> list[str]:
        """Lines for people."""
        by = self.detection
        if by.machine is None:
            lines = ["machine: no picture of a calibrated thermal camera was searched for people"]
        else:
            whom = f"a person {PERSON_K:g} K warmer than the ground"
            lines = [f"machine: {by.searched} of {by.pictures} pictures searched for {whom}"]
        if by.strangers:
            lines.append(f"not counted: {by.strangers} searched pictures whose ground is not known here")
        for sector in self.sectors:
            lines += sector_lines(sector, self.below).values()
        total_m2 = sum(gap.area_m2 for gap in self.gaps)
        lines.append(f"below {self.below:g} by {self.who}: {area_text(total_m2)}, {len(self.gaps)} parts")
        return lines


def sector_lines(sector: SectorDetection, below: float) -> dict[str, str]:
    """A line for the machine, if it has searched, and one for the operator."""
    where = f"in sector {sector.name}" if sector.name else "in the searched area"
    out = {}
    for who, p in (("machine", sector.machine), ("operator", sector.operator)):
        if p is not None:
            left = f"{area_text(sector.below_m2[who])} left below {below:g}"
            out[who] = f"POD {p[0]:.2f} ({p[1]:.2f} to {p[2]:.2f}) by {who} {where}, {left}"
    return out


def gap_dict(gap: Gap) -> dict[str, float]:
    return {"area_m2": round(gap.area_m2, 1), "lat_deg": round(gap.lat_deg, 7), "lon_deg": round(gap.lon_deg, 7)}


def area_text(m2: float) -> str:
    """An area in the unit that people use for its size."""
    return f"{m2 / 1e6:.3f} km2" if m2 >= 1e5 else f"{m2 / 1e4:.2f} ha" if m2 >= 1e3 else f"{m2:.0f} m2"


def share_text(part: float, whole: float) -> str:
    """A share in percent; of nothing, 0."""
    return f"{100.0 * part / whole:.1f} %" if whole > 0.0 else "0 %"
