"""A thing that hot spots of many pictures are of: a value, and how it is written."""

from __future__ import annotations

import json
from dataclasses import dataclass

from contract.answer import CONFIDENCE, Place, rounded, time_utc
from contract.spot import SURE_PICTURES, ThingKind, likely_text
from contract.track import Course


@dataclass(frozen=True)
class SeenSpot:
    """One of its spots: which picture, and where in it."""

    vehicle: str
    session: int
    frame: int
    capture_unix_ns: int
    u_px: float
    v_px: float


@dataclass(frozen=True)
class FoundThing:
    """`place` is the merged one, at the newest sighting where it moves. `course`: at rest without a course in it; None:
    too little is known to decide. `temperature_c` is the highest (of a cold thing the lowest) of any picture, None
    where no camera is calibrated; `contrast` likewise, in sigmas of its ground. `best` is the picture that shows it
    best. `kind` is what a net takes it for and `probability` how likely that is, by the session that is surest (looks
    of several at one place resemble each other too much to be added up); None if it is only hot.
    """

    number: int
    place: Place
    course: Course | None
    pictures: int
    vehicles: tuple[str, ...]
    first_unix_ns: int
    last_unix_ns: int
    temperature_c: float | None
    above_ground_k: float | None
    contrast: float
    area_m2: float
    sigma_area_m2: float
    best: SeenSpot
    newest: SeenSpot
    kind: ThingKind | None = None
    probability: float | None = None
    spots: tuple[SeenSpot, ...] = ()  # those that were the best once, the first and the newest: bounded

    @property
    def is_sure(self) -> bool:
        """True if more than one picture shows it, for noise that looks hot once is not there again; or if a net has
        named it, for that is weighed against all looks on board.
        """
        return self.pictures >= SURE_PICTURES or self.kind is not None

    @property
    def heat_text(self) -> str:
        """The kind that it is taken for, and the heat, in words."""
        word = "colder" if self.contrast < 0.0 else "hotter"
        likely = likely_text(self.kind, self.probability)
        sigmas = f"{abs(self.contrast):.1f} sigmas {word} than its ground"
        if self.temperature_c is None or self.above_ground_k is None:
            return f"{likely}{sigmas} (uncalibrated)"
        return f"{likely}{self.temperature_c:.1f} degC, {self.above_ground_k:+.1f} K, {sigmas}"

    def to_dict(self) -> dict[str, object]:
        """Return the JSON object."""
        b = self.best
        content: dict[str, object] = {
            "spot": self.number, "pictures": self.pictures, "vehicles": list(self.vehicles),
            "first_utc": time_utc(self.first_unix_ns), "last_utc": time_utc(self.last_unix_ns),
            "temperature_c": rounded(self.temperature_c), "above_ground_k": rounded(self.above_ground_k),
            "contrast": round(self.contrast, 2),
            "kind": None if self.kind is None else self.kind.value, "probability": rounded(self.probability),
            **self.place.to_dict(),
            "area_m2": rounded(self.area_m2), "sigma_area_m2": rounded(self.sigma_area_m2),
            "best": {
                "vehicle": b.vehicle, "session": b.session, "frame": b.frame,
                "u": round(b.u_px, 2), "v": round(b.v_px, 2),
            },
        }  # fmt: skip
        if self.course is not None:
            content |= self.course.to_dict()
        return content

    def to_json(self) -> str:
        return json.dumps(self.to_dict())

    def to_text(self) -> str:
        """One line for people."""
        p, e = self.place, self.place.ellipse
        times = "once" if self.pictures == 1 else f"in {self.pictures} pictures since {time_utc(self.first_unix_ns)}"
        return (
            f"spot {self.number}  {self.heat_text}  {e.rounded(p.lat_deg, p.lon_deg)}  {CONFIDENCE:.0%} ellipse "
            f"{e.semi_major_m:.1f} x {e.semi_minor_m:.1f} m at {e.azimuth_deg:.0f} deg  "
            f"{self.course_text}  {self.area_m2:.2g} m2  seen {times}, last by {self.newest.vehicle} "
            f"at {time_utc(self.last_unix_ns)}"
        )

    @property
    def course_text(self) -> str:
        return "speed not known" if self.course is None else self.course.to_text()
