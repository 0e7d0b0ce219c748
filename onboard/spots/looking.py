"""The search for spots: which pictures are looked at and what is found, with one camera or with a second one."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.spots.bracketed import Bracketed, BracketedPictures
from onboard.spots.due_pictures import DuePictures
from onboard.spots.mount_estimate import MountEstimate, Sighting
from onboard.spots.second_camera import STATES, Mount, pixel_of_first, set_of_second
from onboard.spots.spot_book import SpotBook

log = logging.getLogger("pointclick")

LEAST_OWN = 0.02  # of a place's variance, its picture's own share

Look = Callable[[], SpotReport | None]
"""Looks at one picture. Looks are taken in the order in which they were given; any may be left out."""


class Looking(Protocol):
    """Fed with pictures and sets, in order. For one thread at a time.

    `keepers` are given each picture of the second camera that was looked at, by whoever takes the look.
    """

    keepers: list[Callable[[Frame], object]]

    def event(self, event: Event) -> None:
        """Take an event of the first camera's pipeline."""

    def feature_set(self, output: FeatureSet) -> list[Look]:
        """Take a first set; the pictures that are to be looked at now."""

    def second_picture(self, frame: Frame) -> list[Look]:
        """Take a picture of the second camera; the pictures that are to be looked at now."""

    def begin_again(self) -> None:
        """Forget what was learned."""


def looking(config: Config, second: Camera | None, most_held: int) -> Looking:
    """Return the search that the configuration asks for; `second` is the second camera's optics, if there is one."""
    return OneCamera(config, most_held) if second is None else TwoCameras(config, second)


class OneCamera:
    """The camera that gives the poses is the thermal one."""

    def __init__(self, config: Config, most_held: int) -> None:
        self._config = config
        self.keepers: list[Callable[[Frame], object]] = []
        self._due = DuePictures(config.spots.rate_hz, most_held)
        self.begin_again()

    def begin_again(self) -> None:
        self._book = SpotBook(self._config.vehicle.id, self._config.spots, self._config.thermal)

    def event(self, event: Event) -> None:
        self._due.event(event)

    def feature_set(self, output: FeatureSet) -> list[Look]:
        """The set's picture, if it is due."""
        frame = self._due.take(output)
        return [] if frame is None else [lambda: self._book.picture(frame, output)]

    def second_picture(self, frame: Frame) -> list[Look]:
        return []


class TwoCameras:
    """A second camera sees the heat; the first one's sets give the poses. Section 27."""

    def __init__(self, config: Config, camera: Camera) -> None:
        self._config, self._camera = config, camera
        self.keepers: list[Callable[[Frame], object]] = []
        self._lost_s = config.camera.lost_after_s
        self._pictures = BracketedPictures(config.spots.rate_hz, self._lost_s + config.service.max_delay_s)
        self._session = 0
        self.begin_again()

    @property
    def mount(self) -> Mount:
        return self._mount.mount

    def begin_again(self) -> None:
        """Forget what was learned of the ground, and of how the second camera sits."""
        self._book = SpotBook(self._config.vehicle.id, self._config.spots, self._config.heat)
        self._mount = MountEstimate(Mount.stated(self._config.camera.thermal))

    def event(self, event: Event) -> None:
        """The first camera's pictures are not looked at."""

    def feature_set(self, output: FeatureSet) -> list[Look]:
        """The second camera's pictures that it is the next set of, as they are due."""
        return [partial(self._look, found) for found in self._pictures.feature_set(output)]

    def second_picture(self, frame: Frame) -> list[Look]:
        """Keep a picture of the second camera; return looks at those before it that wait no longer for a next set."""
        return [partial(self._look, found) for found in self._pictures.picture(frame)]

    def _look(self, found: Bracketed) -> SpotReport | None:
        mount = self.mount
        its_set, pointing = set_of_second(found, self._camera, mount, self._lost_s)
        report = self._book.picture(found.frame, its_set, pointing)
        if report is None:
            return None
        for keeper in self.keepers:
            keeper(found.frame)
        self._learn(report)
        spots = []
        for spot in report.spots:
            u, v = pixel_of_first(found, its_set, mount, np.array([spot.u_px, spot.v_px]))
            spots.append(replace(spot, u_px=float(u), v_px=float(v)))
        return replace(report, spots=tuple(spots))

    def _learn(self, report: SpotReport) -> None:
        """Update the mount of the second camera by the report's spots.

        A new session starts from the stated mount, for its places count from elsewhere.
        """
        if report.session != self._session:
            self._session, self._mount = report.session, MountEstimate(Mount.stated(self._config.camera.thermal))
        sightings = []
        for one in self._book.newest:
            assert one.fix is not None
            whole = one.fix.covariance_enu_m2[:2, :2]
            mounted = one.pointed_m[:, :STATES]
            left = whole - mounted @ mounted.T
            own = (1.0 - report.picture_share) * float(np.trace(whole) / np.trace(left))
            sightings.append(Sighting(one.place_m, one.by_mount_m, left, min(max(own, LEAST_OWN), 1.0)))
        used = self._mount.things_used
        self._mount.add(report.capture_unix_ns / 1e9, sightings)
        if self._mount.things_used != used:
            log.info("thermal camera: by %d things on the ground: %s", self._mount.things_used, self.mount)
