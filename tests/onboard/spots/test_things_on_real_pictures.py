"""People in real thermal pictures that the net was not trained on (HIT-UAV, ../shared), looked at as in the air."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.spot import SpotReport, ThingKind
from onboard.config.schema import SpotsConfig, ThermalConfig
from onboard.events.types import Frame
from onboard.spots.spot_book import SpotBook
from onboard.spots.thing_net import ThingNet
from simulation.trajectory import Pose
from tests.onboard.spots.scenes import DOWN, STEP_NS, set_of

CAMERA = Camera(640, 512, 2000.0, 2000.0, 319.5, 255.5)  # as the data set's makers' pictures seem to be
THERMAL = ThermalConfig(enabled=True)
KINDS = {
    "Person": ThingKind.PERSON,
    "Car": ThingKind.VEHICLE,
    "OtherVehicle": ThingKind.VEHICLE,
    "Bicycle": ThingKind.OTHER,
}


@dataclass(frozen=True, eq=False)
class Labelled:
    """A picture (512, 640) with its boxes (N, 4), left, top, right, bottom, of each kind; `others`: of no kind."""

    name: str
    counts: NDArray[np.uint16]
    boxes: dict[ThingKind | None, NDArray[np.float64]]

    @property
    def set_at(self) -> FeatureSet:
        return set_over(self.name, 0, 0.0)[1]


@cache
def labelled(folder: Path) -> list[Labelled]:
    out = []
    for path in sorted(folder.glob("*.jpg")):
        boxes: dict[ThingKind | None, list[list[float]]] = {}
        for thing in ET.parse(path.with_suffix(".xml")).findall("object"):
            box = thing.find("bndbox")
            assert box is not None
            kind = KINDS.get(thing.findtext("name", ""))
            boxes.setdefault(kind, []).append(
                [float(box.findtext(side, "")) for side in ("xmin", "ymin", "xmax", "ymax")]
            )
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        out.append(Labelled(path.stem, picture.astype(np.uint16), {k: np.array(b) for k, b in boxes.items()}))
    return out


@pytest.fixture
def pictures(shared_data: Path) -> list[Labelled]:
    return labelled(shared_data / "hit_uav" / "pictures")


def set_over(name: str, frame: int, moved_px: float) -> tuple[Pose, FeatureSet]:
    """The pose that took a picture, by its name; `moved_px` further along its columns."""
    _, height, angle, *_ = name.split("_")
    tilt = np.radians(90.0 - float(angle))
    tilted = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(tilt), -np.sin(tilt)], [0.0, np.sin(tilt), np.cos(tilt)]])
    pose = Pose(np.array([moved_px * float(height) / CAMERA.fx_px, 0.0, float(height)]), DOWN @ tilted)
    return pose, set_of(CAMERA, pose, frame)


def ground_km2(name: str) -> float:
    _, height, angle, *_ = name.split("_")
    return 1e-6 * 640 * 512 * (float(height) / CAMERA.fx_px) ** 2 / float(np.sin(np.radians(float(angle)))) ** 3


def report_of(picture: Labelled, config: SpotsConfig) -> SpotReport:
    book = SpotBook("uav-1", config, THERMAL)
    report = book.picture(Frame(0, 0, np.zeros((512, 640), np.uint8), counts=picture.counts), picture.set_at)
    assert report is not None
    return report


def is_at(boxes: NDArray[np.float64], u: float, v: float, about_px: float = 4.0) -> NDArray[np.bool_]:
    low, high = boxes.reshape(-1, 4)[:, :2] - about_px, boxes.reshape(-1, 4)[:, 2:] + about_px
    return ((low <= (u, v)) & ((u, v) <= high)).all(axis=1)


def test_most_people_have_a_peak_and_little_else_has_one_as_high(pictures: list[Labelled]) -> None:
    """The precision by falling score over 48 pictures of two flights, averaged over recall."""
    net, ranked, people = ThingNet(0.05), [], 0
    for picture in pictures:
        boxes = picture.boxes.get(ThingKind.PERSON, np.zeros((0, 4)))
        people += len(boxes)
        left = boxes.copy()
        for peak in (p for p in net.peaks(picture.counts) if p.kind is ThingKind.PERSON):
            hit = np.flatnonzero(is_at(left, peak.u_px, peak.v_px))
            if len(hit):
                left = np.delete(left, hit[0], axis=0)
            if len(hit) or not is_at(boxes, peak.u_px, peak.v_px).any():
                ranked.append((peak.score, len(hit) > 0))
    hits = np.cumsum([hit for _, hit in sorted(ranked, reverse=True)])
    precision = hits / np.arange(1, len(hits) + 1)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    average = float((best * np.diff(np.append(0, hits))).sum()) / people
    assert people > 100 and 0.6 < average < 0.99


def test_peaks_are_the_same_whatever_the_cameras_gain_offset_and_size_are(pictures: list[Labelled]) -> None:
    net, counts = ThingNet(0.1), pictures[0].counts
    first, other = net.peaks(counts), net.peaks((37.0 * counts + 21000.0).astype(np.uint16))
    assert [(p.kind, round(p.u_px, 1)) for p in first] == [(p.kind, round(p.u_px, 1)) for p in other] and first
    cut = net.peaks(counts[:-7, :-5])  # sides that are no multiples of 16
    assert {p.kind for p in cut[:5]} <= {p.kind for p in first} and abs(cut[0].u_px - first[0].u_px) < 2.0
    assert net.peaks(np.full((512, 640), 3000, np.uint16)) == [] == net.peaks(np.zeros((120, 160), np.uint16))


@pytest.mark.long
def test_single_looks_find_people_as_likely_as_stated_and_fewer_false_ones_than_asked_for(
    pictures: list[Labelled],
) -> None:
    """At 900 a km2, 300 of each kind, where people are as dense as they are in these pictures."""
    boxes = [picture.boxes.get(ThingKind.PERSON, np.zeros((0, 4))) for picture in pictures]
    people, km2 = sum(map(len, boxes)), sum(ground_km2(picture.name) for picture in pictures)
    config = SpotsConfig(things=True, false_per_km2=900.0, things_per_km2=people / km2)
    found = false = 0
    likely: list[tuple[float, bool]] = []
    for picture, there in zip(pictures, boxes, strict=True):
        every = np.concatenate([b.reshape(-1, 4) for b in picture.boxes.values()] or [np.zeros((0, 4))])
        seen = np.zeros(len(there), bool)
        for spot in report_of(picture, config).spots:
            if spot.kind is ThingKind.PERSON:
                seen |= is_at(there, spot.u_px, spot.v_px)
                hit = is_at(every, spot.u_px, spot.v_px).any()
                false += not hit
                likely.append((spot.probability or 0.0, bool(hit)))
        found += int(seen.sum())
    assert 0.2 * people < found < 0.8 * people
    assert false <= 300.0 * km2 + 3.0 * np.sqrt(300.0 * km2)
    stated, share = np.mean(likely, axis=0)
    assert abs(stated - share) < 0.15


def test_a_person_below_a_flight_is_one_place_whose_odds_are_those_of_all_looks(pictures: list[Labelled]) -> None:
    """The picture moves by 20 px from look to look as the aircraft does."""
    picture = next(p for p in pictures if p.name == "1_60_60_0_00487")
    book = SpotBook("uav-1", SpotsConfig(things=True, false_per_km2=300.0), THERMAL)
    places: dict[int, list[tuple[float, float]]] = {}
    for k in range(5):
        moved = np.roll(picture.counts, -20 * k, axis=1)
        its_set = set_over(picture.name, k, 20.0 * k)[1]
        report = book.picture(Frame(k * STEP_NS, k, np.zeros((512, 640), np.uint8), counts=moved), its_set)
        assert report is not None
        places[k] = [(s.place.lat_deg, s.place.lon_deg) for s in report.spots if s.place and s.kind is ThingKind.PERSON]
    assert places[4]
    for place in places[4]:
        assert any(np.hypot(*(1.1e5 * (np.array(place) - other))) < 2.0 for other in places[3])
