"""The probability that a person would have been found in each cell: by the machine, and by an operator who looks.

docs/mathematics-seen.md, (23.5) to (23.12). Looks at one place are not independent: what hides a person in one picture
hides it in the next. So no product of misses is stated: of both what the best looks allow, as if one cause hid a person
in all; of the machine also what no dependence between looks can undercut.
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

    The machine's range is what dependence between looks may do, the operator's how observers differ.

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
        """The probabilities by `machine` or `operator`."""
        return self.machine if who == "machine" else self.operator


@dataclass(frozen=True, eq=False)
class _Searched:
    """A picture that was searched: its number among those of its session, the cells in it, and for each the share of
    the ground about it on which a person would be found.
    """

    number: int
    at: Index
    share: Array


@dataclass(eq=False)
class _Machine:
    """By cell (n,): whom the reports of the pictures that were searched name, `best` and `of_pass` if one cause hides a
    person in all looks, `least` and `thrice` whatever the dependence between looks. (23.5) to (23.8)
    """

    n: int
    best: Array = field(init=False)  # (2, n): the two best reports
    of_pass: Array = field(init=False)
    least: Array = field(init=False)
    thrice: Array = field(init=False)
    missed: Array = field(init=False)  # by all earlier passes, were they independent
    last_ns: Index = field(init=False)
    before: list[_Searched] = field(init=False)  # the last two pictures that were searched
    shares: Array = field(init=False)  # (2, n) of theirs; 0 but while a picture is taken

    def __post_init__(self) -> None:
        self.best, self.of_pass, self.least = (np.zeros((2, self.n)) for _ in range(3))
        self.thrice, self.missed, self.last_ns = np.zeros(self.n), np.ones(self.n), np.zeros(self.n, np.int64)
        self.before, self.shares = [], np.zeros((2, self.n))

    def begin_session(self) -> None:
        """Another aircraft, or the same one again: another pass everywhere, and nothing to be seen again in."""
        self._end_pass(np.arange(self.n))
        self.before = []

    def look(self, picture: _Searched, capture_unix_ns: int) -> None:
        """The next picture of the session that was searched."""
        at, share = picture.at, picture.share
        is_new = capture_unix_ns - self.last_ns[at] > PASS_S * 1e9
        self._end_pass(at[is_new])
        self.last_ns[at] = capture_unix_ns
        self.before = [one for one in self.before if one.number >= picture.number - 2]
        for row, one in zip(self.shares, self.before, strict=False):
            row[one.at] = one.share
        either, both = self.shares[:, at].max(axis=0), self.shares[:, at].sum(axis=0)
        for row, one in zip(self.shares, self.before, strict=False):
            row[one.at] = 0.0
        self.before.append(picture)
        _insert(self.best, at, np.minimum(share, either))
        _insert(self.of_pass, at, np.minimum(share, either))
        _insert(self.least, at, np.maximum(share + either - 1.0, 0.0))
        self.thrice[at] = np.maximum(self.thrice[at], share + both - 2.0)

    def _end_pass(self, at: Index) -> None:
        self.missed[at] *= 1.0 - self.of_pass[1, at]
        self.of_pass[:, at] = 0.0

    def probabilities(self) -> Array:
        """As stated, lowest, highest (3, n)."""
        self.begin_session()
        least = np.maximum(np.maximum(self.thrice, self.least.sum(axis=0) - 1.0), 0.0)
        return np.stack([self.best[1], least, np.maximum(self.best[1], 1.0 - self.missed)])


def _insert(two: Array, at: Index, value: Array) -> None:
    """Keep the larger two of what is held and a new value."""
    first, second = two[0, at], two[1, at]
    two[1, at] = np.maximum(second, np.minimum(first, value))
    two[0, at] = np.maximum(first, value)


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
    numbered = _numbered(reports)
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
        found = numbered.get((*key, capture_unix_ns))
        if found is not None:
            searched.add(key)
            by_cell = _by_cell(found[1], cells)
            if len(at):
                shares.append((float(np.median(cells.gsd_m)), float(by_cell.mean())))
            machine.look(_Searched(found[0], at, by_cell[kept]), capture_unix_ns)
    open_share = 1.0 - _canopy(over, woods)[over.seen]
    by_operator = searched_for(final, final_s)
    return Detection(
        _on_cells(machine.probabilities() * open_share, over) if searched else None,
        _on_cells(by_operator * open_share, over),
        len(looks),
        len(searched),
        len(numbered) - len(searched),
        shares,
    )


def _by_cell(report: SpotReport, cells: PictureCells) -> Array:
    """The share (N,) that a report states for the part of its picture in which each cell is."""
    if cells.view is None:
        return np.zeros(len(cells))
    rows, columns = PERSON_GRID
    across, down = cells.view.places(cells.row, cells.column).T
    parts = np.array([0.0 if share is None else share for share in report.person_parts])
    out: Array = parts[(down * rows).astype(np.int64) * columns + (across * columns).astype(np.int64)]
    return out


def _numbered(reports: Iterable[SpotReport]) -> dict[tuple[str, int, int, int], tuple[int, SpotReport]]:
    """By vehicle, session, frame and capture: which picture of its session it was that was searched, and its report.

    The capture too, for a second camera counts its own pictures. Only of those that state who would be found.
    """
    once = {(r.vehicle, r.session, r.frame, r.capture_unix_ns): r for r in reports}  # however often it came
    out, numbers = {}, dict[tuple[str, int], int]()
    for r in sorted(once.values(), key=lambda r: r.capture_unix_ns):
        session = r.vehicle, r.session
        numbers[session] = number = numbers.get(session, 0) + 1
        if r.person_found is not None:
            out[(*session, r.frame, r.capture_unix_ns)] = number, r
    return out


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
