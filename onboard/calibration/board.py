"""The calibration board: its picture for the printer, and its corners found in a photograph."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from onboard.calibration.intrinsics import View

Grey = NDArray[np.uint8]

LEAST_CORNERS = 8
"""The least number of corners in a view: fewer constrain little and are more often wrong."""
MAX_SQUARES = 40
DICTIONARIES = tuple(
    sorted(
        name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith(("DICT_4X4", "DICT_5X5", "DICT_6X6"))
    )
)


@dataclass(frozen=True)
class Board:
    """ChArUco (squares with markers: part of it in the picture is enough) or a plain checkerboard."""

    kind: Literal["charuco", "checkerboard"] = "charuco"
    columns: int = 7
    rows: int = 10
    square_m: float = 0.025
    marker_m: float = 0.0185
    dictionary: str = "5X5_100"

    def __post_init__(self) -> None:
        """Raises InputError for a board that cannot be."""
        if not (3 <= self.columns <= MAX_SQUARES and 3 <= self.rows <= MAX_SQUARES):
            raise InputError(f"board of {self.columns}x{self.rows} squares: 3 to {MAX_SQUARES} each way")
        if not 0.001 <= self.square_m <= 1.0:
            raise InputError(f"board squares of {self.square_m * 1000:g} mm: 1 to 1000 mm")
        if self.kind == "checkerboard":
            return
        if self.dictionary not in DICTIONARIES:
            raise InputError(f"marker dictionary {self.dictionary!r}: one of {', '.join(DICTIONARIES)}")
        if not 0.3 * self.square_m <= self.marker_m <= 0.9 * self.square_m:
            raise InputError(f"markers of {self.marker_m * 1000:g} mm: 0.3 to 0.9 of a square")
        if self.columns * self.rows // 2 > len(self._markers.bytesList):
            raise InputError(
                f"a board of {self.columns}x{self.rows} squares needs {self.columns * self.rows // 2} markers, "
                f"dictionary {self.dictionary} has {len(self._markers.bytesList)}"
            )

    @cached_property
    def _markers(self) -> Any:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))

    @cached_property
    def _charuco(self) -> Any:
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, self._markers)

    @cached_property
    def _detector(self) -> Any:
        return cv2.aruco.CharucoDetector(self._charuco)

    @property
    def corners(self) -> int:
        return (self.columns - 1) * (self.rows - 1)

    def points_m(self) -> NDArray[np.float64]:
        """Every inner corner, (N, 3), row by row: x to the right, y down, the origin at the board's upper left."""
        y, x = np.mgrid[1 : self.rows, 1 : self.columns].astype(float) * self.square_m
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)

    def picture(self, square_px: int) -> Grey:
        """The board alone, without a margin, (rows * square_px, columns * square_px)."""
        if self.kind == "charuco":
            size_px = self.columns * square_px, self.rows * square_px
            return np.asarray(self._charuco.generateImage(size_px, marginSize=0), np.uint8)
        y, x = np.mgrid[: self.rows, : self.columns]
        squares = np.where((x + y) % 2 == 0, 0, 255).astype(np.uint8)
        return np.kron(squares, np.ones((square_px, square_px), np.uint8))

    def find(self, picture: Grey, name: str = "") -> View | None:
        """The board's corners in a picture (H, W); None if there is no board, or too little of it."""
        found = self._find_charuco(picture) if self.kind == "charuco" else self._find_checkerboard(picture)
        if found is None or len(found[0]) < min(LEAST_CORNERS, self.corners):
            return None
        numbers, uv_px = found
        points_m = self.points_m()[numbers]
        # Corners along one line fix no pose.
        if min(np.ptp(points_m[:, 0]), np.ptp(points_m[:, 1])) < 0.5 * self.square_m:
            return None
        return View(name, numbers, uv_px, points_m)

    def _find_charuco(self, picture: Grey) -> tuple[NDArray[np.intp], NDArray[np.float64]] | None:
        uv_px, numbers, _, _ = self._detector.detectBoard(picture)
        if numbers is None or uv_px is None:
            return None
        return np.asarray(numbers, np.intp).ravel(), np.asarray(uv_px, np.float64).reshape(-1, 2)

    def _find_checkerboard(self, picture: Grey) -> tuple[NDArray[np.intp], NDArray[np.float64]] | None:
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
        is_there, uv_px = cv2.findChessboardCornersSB(picture, (self.columns - 1, self.rows - 1), flags=flags)
        if not is_there:
            return None
        return np.arange(self.corners), np.asarray(uv_px, np.float64).reshape(-1, 2)
