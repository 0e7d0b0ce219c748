"""A mark: what every format writes, made from an answered or refused click, or from a pin."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from contract.answer import Answer, Ellipse, Refusal, time_utc
from contract.circular_error import ce90_m, le90_m
from contract.feature_set import Status
from ground.pins.fusion import Contradiction, Fused, Place, Unplaced
from ground.pins.model import Pin
from ground.spots.found_thing import FoundThing

PLACED = "ok"
CONTRADICTING = "contradicting"
MACHINE = "hot spot, unconfirmed"  # method of what a program found and no person has looked at


def up(metres: float) -> float:
    """The length rounded up to a tenth: the stated accuracy is never better than the known one."""
    return math.ceil(metres * 10.0 - 1e-9) / 10.0 if math.isfinite(metres) else metres


@dataclass(frozen=True, eq=False)
class Mark:
    """One thing to pass on. Without a position (`lat_deg` None) `status` and `reason` state why.

    Accuracies are None where they are not known: 90 % ellipse and circle, 90 % of the height, one sigma of it.
    """

    id: str
    name: str
    status: str
    reason: str = ""
    number: int | None = None
    note: str = ""
    category: str = "poi"
    who: str = ""
    lat_deg: float | None = None
    lon_deg: float | None = None
    height_ellipsoid_m: float | None = None
    height_amsl_m: float | None = None
    ellipse: Ellipse | None = None
    ce90_m: float | None = None
    le90_m: float | None = None
    sigma_height_m: float | None = None
    heights_apart_m: float | None = None  # of a pin whose aircraft's heights contradict each other: it has none
    time_unix_ns: int | None = None  # when it was seen last: its newest picture's time
    modified_unix_ns: int | None = None
    vehicle: str = ""
    frame: int | None = None
    u_px: float | None = None
    v_px: float | None = None
    method: str = ""
    clicks: int = 1
    tied: int = 0
    pin: Pin | None = field(default=None, repr=False)
    answer: Answer | None = field(default=None, repr=False)

    @property
    def is_placed(self) -> bool:
        return self.lat_deg is not None and self.lon_deg is not None

    @property
    def position(self) -> tuple[float, float]:
        """Latitude and longitude. Raises ValueError without a position."""
        if self.lat_deg is None or self.lon_deg is None:
            raise ValueError(f"{self.title} has no position: {self.reason}")
        return self.lat_deg, self.lon_deg

    @property
    def title(self) -> str:
        """Number and name, for people."""
        return f"{self.number_text} {self.name}".strip() or self.id

    @property
    def number_text(self) -> str:
        """The number, for people, with others that it had; empty if there is none."""
        was = () if self.pin is None else self.pin.was
        former = f" (was {', '.join(map(str, was))})" if was else ""
        return "" if self.number is None else f"{self.number}{former}"

    @property
    def time_text(self) -> str:
        """ISO 8601 with microseconds; empty if it is not known."""
        return "" if self.time_unix_ns is None else time_utc(self.time_unix_ns)

    @property
    def accuracy_text(self) -> str:
        """Position and height accuracy in one line, in the words of every format: the figures are 90 %."""
        if not self.is_placed:
            return f"no position: {self.status}: {self.reason}"
        parts = ["accuracy not known" if self.ce90_m is None else f"+-{up(self.ce90_m):.1f} m (CE90)"]
        if self.height_amsl_m is not None:
            parts.append(f"height {self.height_amsl_m:.1f} m AMSL")
        elif self.height_ellipsoid_m is not None:
            parts.append(f"height {self.height_ellipsoid_m:.1f} m above the WGS84 ellipsoid")
        if self.heights_apart_m is not None:
            parts.append(f"no height: those of its clicks are {self.heights_apart_m:.0f} m apart")
        if self.le90_m is not None:
            parts[-1] += f" +-{up(self.le90_m):.1f} m (LE90)"
        if self.ellipse is not None:
            e = self.ellipse
            parts.append(
                f"90 % ellipse {up(e.semi_major_m):.1f} x {up(e.semi_minor_m):.1f} m, "
                f"long axis at {e.azimuth_deg:.0f} deg"
            )
        return ", ".join(parts)

    @classmethod
    def of_answer(cls, answer: Answer, uv_px: tuple[float, float] | None = None, number: int | None = None) -> Mark:
        """Make the mark of a click. Its id is what the click was: vehicle, frame and pixel."""
        u, v = (None, None) if uv_px is None else uv_px
        frame = "newest" if answer.frame is None else str(answer.frame)
        name = f"click {u:g} {v:g}" if u is not None else "click"
        key = f"click-{answer.vehicle or 'none'}-{frame}-{u}-{v}"
        if isinstance(answer, Refusal):
            return cls(
                key, name, answer.status.value, answer.reason, number, vehicle=answer.vehicle or "",
                time_unix_ns=answer.capture_unix_ns, frame=answer.frame, u_px=u, v_px=v, answer=answer,
            )  # fmt: skip
        return cls(
            key, name, PLACED, "", number, lat_deg=answer.lat_deg, lon_deg=answer.lon_deg,
            height_ellipsoid_m=answer.height_ellipsoid_m, height_amsl_m=answer.height_amsl_m, ellipse=answer.ellipse,
            ce90_m=ce90_m(answer.covariance_enu_m2[:2, :2]), le90_m=le90_m(answer.sigma_height_m),
            sigma_height_m=answer.sigma_height_m, time_unix_ns=answer.capture_unix_ns, vehicle=answer.vehicle,
            frame=answer.frame, u_px=u, v_px=v, method=answer.method, answer=answer,
        )  # fmt: skip

    @classmethod
    def of_found(cls, thing: FoundThing) -> Mark:
        """Make the mark of a thing found as hot spots, which no person has confirmed."""
        p, best = thing.place, thing.best
        return cls(
            f"spot-{thing.spots[0].vehicle}-{thing.spots[0].session}-{thing.spots[0].frame}-{thing.number}",
            f"spot {thing.number}", PLACED, "", thing.number, thing.to_text().partition("  ")[2],
            lat_deg=p.lat_deg, lon_deg=p.lon_deg, height_ellipsoid_m=p.height_ellipsoid_m,
            height_amsl_m=p.height_amsl_m, ellipse=p.ellipse, ce90_m=ce90_m(p.ellipse.covariance_en_m2),
            le90_m=le90_m(p.sigma_height_m), sigma_height_m=p.sigma_height_m, time_unix_ns=thing.last_unix_ns,
            vehicle=" ".join(thing.vehicles), frame=best.frame, u_px=best.u_px, v_px=best.v_px, method=MACHINE,
            clicks=thing.pictures,
        )  # fmt: skip

    @classmethod
    def of_pin(cls, pin: Pin, place: Fused) -> Mark:
        """Make the mark of a pin at its present place (`Places.place`)."""
        newest = max(pin.clicks, key=lambda c: c.capture_unix_ns or c.clicked_unix_ns, default=None)
        vehicles = sorted({click.vehicle for click in pin.clicks if click.vehicle})
        words = {
            "number": pin.number, "note": pin.note, "category": pin.category.value, "who": pin.who,
            "time_unix_ns": pin.seen_unix_ns, "modified_unix_ns": pin.modified_unix_ns, "vehicle": " ".join(vehicles),
            "method": "" if newest is None else newest.method, "clicks": len(pin.clicks), "pin": pin,
        }  # fmt: skip
        name = pin.name
        if isinstance(place, Contradiction):
            return cls(pin.id, name, CONTRADICTING, place.reason, **words)  # type: ignore[arg-type]
        if isinstance(place, Unplaced):
            return cls(pin.id, name, Status.UNCERTAIN.value, place.reason, **words)  # type: ignore[arg-type]
        assert isinstance(place, Place)
        return cls(
            pin.id, name, PLACED, "", **words, lat_deg=place.lat_deg, lon_deg=place.lon_deg,  # type: ignore[arg-type]
            height_ellipsoid_m=place.height_ellipsoid_m, height_amsl_m=place.height_amsl_m, ellipse=place.ellipse,
            ce90_m=place.ce90_m, le90_m=place.le90_m, sigma_height_m=place.sigma_height_m, tied=place.tied,
            heights_apart_m=place.heights_apart_m,
        )  # fmt: skip
