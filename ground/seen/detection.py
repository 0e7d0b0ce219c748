"""The probability that a person would have been found in each cell: by the machine, and by an operator who looks.

docs/mathematics-seen.md, (23.5) to (23.12). Looks at one place are not independent: what hides a person in one picture
hides it in the next, in part. So no product of misses is stated: of the machine whom the aircraft itself would have
named, as it tries the same people in all pictures of a place, and of an operator what the best look allows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.spot import PERSON_GRID, PERSON_M2, SpotReport
from ground.seen.area import Woods
from ground.seen.coverage import Coverage
from ground.seen.outline import Mask, cells_within
from ground.seen.picture_cells import PictureCells
from ground.seen.pictures import Key, Look

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_CELLS = 8_000_000
PASS_S = 60.0  # without a look, after which the next one begins another pass
PERSON_M = float(np.sqrt(PERSON_M2))
# Line pairs on a person at which half of the observers detect it: Johnson 1958, 1.0 +- 0.25. Middle, worst, best.
HALF_CYCLES = np.array([1.0, 1.25, 0.75])
SEARCH_S = 3.4  # time constant of a search in a picture, divided by its final probability (Howe 1993)
LOOK_S = 5.0  # at most, for which an operator who watches along looks at a picture, if no more follow


@dataclass(frozen=True, eq=False)
class Detection:
    """Probabilities (3, rows, columns) over the cells of a coverage: as stated, lowest and highest. 0: not seen.

    The machine's range is what dependence between passes may do, the operator's how observers differ.

    `machine` is None where no picture of a calibrated thermal camera was searched; `searched` pictures were.
    `strangers` are reports of pictures that have no set here, which count for nothing.
    """

    machine: Array | None
    operator: Array
    pictures: int
    searched: int
    strangers: int
    shares: Sequence[tuple[float, float]] = ()  # of each picture that was searched: median sample distance (m), share

    def of(self, who: str) -> Array | None:
        return self.machine if who == "machine" else self.operator


@dataclass(eq=False)
class _Machine:
    """The state of the machine's search by cell (n,): the share of people about it whom the session had named when a
    pass last saw it, of all passes the `best`; what all would name together, were they independent. (23.5) to (23.8)
    """

    n: int
    best: Array = field(init=False)
    of_pass: Array = field(init=False)
    missed: Array = field(init=False)  # by all earlier passes, were they independent
    last_ns: Index = field(init=False)

    def __post_init__(self) -> None:
        self.best, self.of_pass, self.missed = np.zeros(self.n), np.zeros(self.n), np.ones(self.n)
        self.last_ns = np.zeros(self.n, np.int64)

    def begin_session(self) -> None:
        """Another aircraft, or the same one again: another pass everywhere."""
        self._end_pass(np.arange(self.n))

    def look(self, at: Index, named: Array, capture_unix_ns: int) -> None:
        """The next picture of the session that was searched: its cells, and the share of people named about each."""
        self._end_pass(at[capture_unix_ns - self.last_ns[at] > PASS_S * 1e9])
        self.last_ns[at], self.of_pass[at] = capture_unix_ns, named

    def _end_pass(self, at: Index) -> None:
        self.best[at] = np.maximum(self.best[at], self.of_pass[at])
        self.missed[at] *= 1.0 - self.of_pass[at]
        self.of_pass[at] = 0.0

    def probabilities(self) -> Array:
        """As stated, lowest, highest (3, n)."""
        self.begin_session()
        return np.stack([self.best, self.best, np.maximum(self.best, 1.0 - self.missed)])


def final_probability(gsd_m: Array | float) -> Array:
    """The share of observers (3, ...) who ever detect a person at a ground sample distance, however long they look:
    as stated, by the worst and by the best of Johnson's figures. (23.9)
    """
    cycles = 0.5 * PERSON_M / np.asarray(gsd_m, float)
    x = cycles / HALF_CYCLES.reshape(3, *[1] * cycles.ndim)
    return np.asarray(1.0 / (1.0 + x ** -(2.7 + 0.7 * x)))


def searched_for(final: Array, final_s: Array) -> Array:
    """The probability of detection after looks with the best final probability of all, and their sum of it times the
    seconds of each. (23.10)
    """
    out: Array = final * -np.expm1(-final_s / SEARCH_S)
    return out


def detection(
    looks: Sequence[Look],
    over: Coverage,
    reports: Iterable[SpotReport] = (),
    woods: Sequence[Woods] = (),
    *,
    look_s: float | None = None,
) -> Detection:
    """The detection over a coverage's cells by all looks, as `SeenGround.looks` has them.

    `look_s` is how long an operator gave each picture; None: until the next.

    Raises InputError for too many cells.
    """
    rows, columns = over.seen.shape
    n = int(over.seen.sum())
    if n > MOST_CELLS:
        raise InputError(
            f"{n} cells were seen, and detection is computed for at most {MOST_CELLS}: choose larger cells"
        )
    number = np.full((rows, columns), -1, np.int64)
    number[over.seen] = np.arange(n)
    reported = _reported(reports)
    machine, final, final_s = _Machine(n), np.zeros((3, n)), np.zeros((3, n))
    session: tuple[str, int] | None = None
    searched, shares = set[Key](), list[tuple[float, float]]()
    for (key, capture_unix_ns, cells_of), duration_s in zip(looks, _seconds(looks, look_s), strict=True):
        cells = cells_of()
        inside = _numbers(number, over, cells)
        kept = inside >= 0
        at = inside[kept]
        each = final_probability(cells.gsd_m[kept])
        final[:, at] = np.maximum(final[:, at], each)
        final_s[:, at] += duration_s * each
        if session != key[:2]:
            machine.begin_session()
            session = key[:2]
        report = reported.get((*key, capture_unix_ns))
        if report is not None and report.person_found is not None:
            searched.add(key)
            if len(at):
                shares.append((float(np.median(cells.gsd_m)), report.person_found))
            machine.look(at, _by_cell(report, cells)[kept], capture_unix_ns)
    open_share = 1.0 - _canopy(over, woods)[over.seen]
    by_operator = searched_for(final, final_s)
    return Detection(
        _on_cells(machine.probabilities() * open_share, over) if searched else None,
        _on_cells(by_operator * open_share, over),
        len(looks),
        len(searched),
        len(reported) - len(searched),
        shares,
    )


def _by_cell(report: SpotReport, cells: PictureCells) -> Array:
    """The share (N,) of people named that a report states for the part of its picture in which each cell is."""
    if cells.view is None:
        return np.zeros(len(cells))
    rows, columns = PERSON_GRID
    across, down = cells.view.places(cells.row, cells.column).T
    parts = np.array([0.0 if share is None else share for share in report.person_named])
    out: Array = parts[(down * rows).astype(np.int64) * columns + (across * columns).astype(np.int64)]
    return out


def _reported(reports: Iterable[SpotReport]) -> dict[tuple[str, int, int, int], SpotReport]:
    """The reports that state who would have been named, by vehicle, session, frame and capture; each once.

    By the capture too, for a second camera counts its own pictures.
    """
    return {(r.vehicle, r.session, r.frame, r.capture_unix_ns): r for r in reports if r.person_named}


def _seconds(looks: Sequence[Look], look_s: float | None) -> list[float]:
    """The seconds for which an operator looks at each picture."""
    if look_s is not None:
        return [look_s] * len(looks)
    following = [
        b.capture_unix_ns - a.capture_unix_ns if a.key[:2] == b.key[:2] else None for a, b in itertools.pairwise(looks)
    ]
    return [LOOK_S if ns is None else min(ns * 1e-9, LOOK_S) for ns in [*following, None]][: len(looks)]


def _numbers(number: Index, over: Coverage, cells: PictureCells) -> Index:
    """The numbers of a picture's cells among those of a coverage that were seen; -1 outside of it."""
    row, column = cells.row - over.row0, cells.column - over.column0
    inside = (row >= 0) & (row < number.shape[0]) & (column >= 0) & (column < number.shape[1])
    out = np.full(len(cells), -1, np.int64)
    out[inside] = number[row[inside], column[inside]]
    return out


def _inside(over: Coverage, polygons: Sequence[Sequence[Array]]) -> Mask:
    """The cells inside of polygons of rings (K, 2) of longitude and latitude."""
    return cells_within([[over.from_lon_lat(ring) for ring in rings] for rings in polygons], *over.seen.shape)


def _canopy(over: Coverage, woods: Sequence[Woods]) -> Array:
    """The share (rows, columns) that trees hide from above, by cell: where woods overlap, of the densest. (23.11)"""
    out = np.zeros(over.seen.shape)
    for wood in woods:
        out = np.where(_inside(over, wood.polygons), np.maximum(out, wood.canopy), out)
    return out


def _on_cells(values: Array, over: Coverage) -> Array:
    """Values (3, n) of the cells that were seen, on all of them."""
    out = np.zeros((3, *over.seen.shape))
    out[:, over.seen] = values
    return out


@dataclass(frozen=True)
class SectorDetection:
    """A sector's mean probabilities, over all of its area: (stated, lowest, highest); m2 of it and below the wanted."""

    name: str
    area_m2: float
    machine: tuple[float, float, float] | None
    operator: tuple[float, float, float]
    below_m2: Mapping[str, float]  # by `machine` (where it is known) and `operator`

    def to_dict(self) -> dict[str, object]:
        """Return the JSON object."""

        def spread(p: tuple[float, float, float] | None) -> dict[str, float] | None:
            return None if p is None else dict(zip(("pod", "low", "high"), (round(x, 4) for x in p), strict=True))

        return {
            "sector": self.name, "area_m2": round(self.area_m2, 1), "machine": spread(self.machine),
            "operator": spread(self.operator), "below_m2": {who: round(m2, 1) for who, m2 in self.below_m2.items()},
        }  # fmt: skip


def sector_detection(
    name: str, polygons: Sequence[Sequence[Array]] | None, over: Coverage, by: Detection, wanted: float
) -> SectorDetection:
    """The detection in polygons of rings (K, 2) of longitude and latitude, or in all of the searched area. (23.12)

    Raises InputError for a sector in which there is no cell.
    """
    inside = over.searched
    if polygons is not None:
        inside = _inside(over, polygons)
    weights = np.where(inside, over.cell_m2[:, None], 0.0)
    area = float(weights.sum())
    if area <= 0.0:
        raise InputError(f"sector {name}: smaller than a cell of {over.cells.cell_m:g} m")

    def mean(p: Array) -> tuple[float, float, float]:
        stated, low, high = (float((each * weights).sum()) / area for each in p)
        return stated, low, high

    who = {"operator": by.operator} if by.machine is None else {"machine": by.machine, "operator": by.operator}
    below = {name: float(weights[p[0] < wanted].sum()) for name, p in who.items()}
    return SectorDetection(name, area, None if by.machine is None else mean(by.machine), mean(by.operator), below)
