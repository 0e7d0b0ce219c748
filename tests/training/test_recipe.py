"""The recipe's parts that need no PyTorch: labels, crops, targets, scores, calibration, and what repeats."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from onboard.spots.thing_net import SIZE_UNIT_PX, STRIDE
from training.again import again, fitted, flights
from training.calibration import counted, isotonic, log_ratio_sigma, reliability, smoothed, tables
from training.crops import ASIDE, SIDE_PX, Crops, moved, warp_around
from training.labelled_pictures import (
    APART,
    CALIBRATION,
    KINDS,
    TEST,
    UNTOUCHED_PART,
    Labelled,
    read_all,
    split,
    stretches,
)
from training.net_input import level_of, level_of_histogram, net_input
from training.peaks import judge, peaks_of
from training.repeats import corners_of, correlation, false_places, overlay, pairs_of, same_things, seen
from training.score import Looks, average_precision, joined, look_at, of_pictures, recall_at
from training.targets import targets_of

Array = NDArray[np.float64]
NONE = np.zeros((0, 4))
OBJECT = "<object><name>{}</name><bndbox><xmin>{}</xmin><ymin>{}</ymin><xmax>{}</xmax><ymax>{}</ymax></bndbox></object>"


def texture(seed: int, height: int = 256, width: int = 320) -> NDArray[np.uint8]:
    rough = np.random.default_rng(seed).normal(0.0, 1.0, (height, width))
    smooth = cv2.GaussianBlur(rough, (0, 0), 2.0)
    return np.clip(110 + 60 * smooth / smooth.std() / 3, 0, 255).astype(np.uint8)


def labelled(folder: Path, name: str, objects: str, picture: NDArray[np.uint8] | None = None) -> None:
    for part in ("Annotations", "JPEGImages"):
        (folder / part).mkdir(exist_ok=True)
    (folder / "Annotations" / f"{name}.xml").write_text(f"<annotation>{objects}</annotation>")
    cv2.imwrite(str(folder / "JPEGImages" / f"{name}.jpg"), texture(1) if picture is None else picture)


def maps_of(things: Array, rows: int = 64, columns: int = 80) -> NDArray[np.float32]:
    """The maps of a net that makes no mistake."""
    targets = targets_of(things, rows, columns)
    maps = np.concatenate([targets.heat, np.zeros((4, rows, columns), np.float32)])
    maps[3:, targets.cells[:, 0], targets.cells[:, 1]] = targets.shapes.T
    return maps


def test_labels_are_read_and_what_they_leave_open_is_no_thing(tmp_path: Path) -> None:
    labelled(
        tmp_path, "1_60_30_0_00007", OBJECT.format("Person", 10, 20, 18, 36) + OBJECT.format("DontCare", 1, 2, 3, 4)
    )
    labelled(tmp_path, "0_100_90_0_00003", OBJECT.format("OtherVehicle", 0, 0, 40, 20))
    first, second = read_all(tmp_path)
    assert (first.number, first.is_day, second.number, second.is_day) == (3, True, 7, False)
    assert second.things.tolist() == [[0, 14, 28, 8, 16]]
    assert second.left_open.tolist() == [[1, 2, 3, 4]]
    assert first.things[0, 0] == KINDS.index("vehicle")
    # 100 m straight down: 5 cm a pixel. 60 m at 30 degrees: 6 cm across, 12 along.
    assert first.ground_m2(1) == pytest.approx(0.05**2)
    assert second.ground_m2(1) == pytest.approx(0.06 * 0.12)
    with pytest.raises(ValueError, match="normal_xml"):
        read_all(tmp_path / "elsewhere")


def test_nothing_trains_that_shows_what_tests_or_calibrates() -> None:
    pictures = [Labelled(Path("x"), n, True, 60.0, 1.0, np.zeros((0, 5)), NONE) for n in range(1, 10200)]
    data = split(pictures)
    numbers = [np.array([p.number for p in part]) for part in data]
    for first, last in (*TEST, *CALIBRATION):
        assert not ((numbers[0] > first - APART) & (numbers[0] < last + APART)).any()
    assert not set(numbers[1]) & set(numbers[2])
    assert len(numbers[1]) == sum(last - first + 1 for first, last in CALIBRATION)
    assert len(numbers[2]) == sum(last - first + 1 for first, last in TEST)
    assert len(numbers[0]) + len(numbers[1]) + len(numbers[2]) > 0.95 * len(pictures)
    elsewhere = split(pictures, calibration=UNTOUCHED_PART)
    part, rest = ({p.number for p in pictures} for pictures in (elsewhere.calibration, elsewhere.test))
    assert part | rest == set(numbers[2].tolist())
    assert not part & rest


def test_a_stretch_ends_where_the_view_changes_or_numbers_are_left_out() -> None:
    views = [(1, 60.0), (2, 60.0), (3, 70.0), (9, 70.0), (200, 70.0)]
    pictures = [Labelled(Path("x"), n, True, height, 1.0, np.zeros((0, 5)), NONE) for n, height in views]
    assert stretches(pictures).tolist() == [0, 0, 1, 1, 2]


def test_input_is_free_of_gain_and_offset_and_its_level_follows_the_tones() -> None:
    grey = texture(3)
    one = net_input(grey, level_of(grey))
    brighter = grey.astype(np.float32) * 0.5 + 90.0
    mean, spread = float(brighter.mean()), float(brighter.std())
    other = net_input(brighter, level_of(grey)._replace(mean=mean, spread=spread))
    assert one.shape == (2, *grey.shape)
    assert np.abs(one - other).max() < 0.06
    assert abs(float(one[0].mean())) < 0.01
    assert 0.98 < float(one[0].std()) <= 1.0
    tones = 255.0 * np.linspace(0.0, 1.0, 256) ** 0.6
    toned = level_of_histogram(np.bincount(grey.ravel(), minlength=256).astype(np.float64), tones)
    assert toned == pytest.approx((tones[grey].mean(), tones[grey].std()), rel=1e-9)


def test_targets_return_as_the_peaks_that_they_are_of() -> None:
    things = np.array([[0, 40.3, 61.8, 9.0, 17.0], [1, 200.0, 100.0, 40.0, 24.0], [0, 300.6, 12.1, 8.0, 8.0]])
    peaks = peaks_of(maps_of(things))
    order = np.lexsort((peaks.middle_px[:, 0], peaks.kind))
    assert len(order) == 3
    expected = things[[0, 2, 1]]
    assert np.abs(peaks.middle_px[order] - expected[:, 1:3]).max() < 1e-4
    assert np.abs(peaks.size_px[order] - expected[:, 3:5]).max() < 1e-4
    heat = targets_of(things[:1], 64, 80).heat[0]
    assert heat.max() == 1.0
    assert 0.3 < heat[15, 11] < 0.4  # a cell aside, for the least sigma of 0.7 cells
    assert STRIDE * 4 == SIZE_UNIT_PX


def test_one_peak_is_a_thing_s_and_what_is_left_open_does_not_count() -> None:
    things = np.array([[0, 50.0, 50.0, 10.0, 10.0]])
    maps = np.zeros((7, 64, 80), np.float32)
    for kind, row, column, score in ((0, 12, 12, 0.6), (0, 12, 15, 0.4), (1, 12, 12, 0.9), (0, 40, 40, 0.8)):
        maps[kind, row, column] = score
    peaks = peaks_of(maps)
    judged = judge(peaks, things, np.array([[155.0, 155.0, 165.0, 165.0]]))
    at = {
        (k, round(s, 1)): (t, c)
        for k, s, t, c in zip(peaks.kind, peaks.score, judged.thing, judged.counts, strict=True)
    }
    assert at == {(0, 0.6): (0, True), (0, 0.4): (-1, True), (1, 0.9): (-1, True), (0, 0.8): (-1, False)}
    assert peaks.score[judged.found_by[0]] == pytest.approx(0.6)


def test_average_precision_and_recall_are_those_of_a_list_counted_by_hand() -> None:
    score, true = np.array([0.9, 0.8, 0.7, 0.6, 0.5]), np.array([True, False, True, True, False])
    # Precision 1, 1/2, 2/3, 3/4: the best from there on is 1, 3/4 and 3/4.
    assert average_precision(score, true, 4) == pytest.approx((1.0 + 0.75 + 0.75) / 4)
    assert average_precision(score, np.ones(5, bool), 5) == 1.0
    assert recall_at(score, true, 4, 0.0) == (0.25, 0.9)
    assert recall_at(score, true, 4, 1.0) == (0.75, 0.6)
    assert recall_at(score, ~true, 4, 0.5) == (0.0, 1.0)


def test_a_crop_s_labels_lie_where_its_things_are(tmp_path: Path) -> None:
    grey = (texture(5, 512, 640) // 4).astype(np.uint8)
    cv2.circle(grey, (400, 300), 5, 255, -1)
    labelled(tmp_path, "1_60_30_0_00001", OBJECT.format("Person", 394, 294, 406, 306), grey)
    crops = Crops(read_all(tmp_path), np.random.default_rng(2))
    off = []
    for _ in range(40):
        crop = crops.draw()
        assert crop.channels.shape == (2, SIDE_PX, SIDE_PX)
        for _, u, v, width, height in crop.things:
            near = crop.channels[:, max(round(v) - 2, 0) : round(v) + 3, max(round(u) - 2, 0) : round(u) + 3]
            off.append(abs(float(near[1].mean())))
            assert 12 * 0.7 * 0.95 < width < 12 * 1.6 * 1.3
            assert width == pytest.approx(height)
    assert 20 < len(off) <= 40
    assert np.mean(np.array(off) > 1.5) > 0.95  # bright or, inverted, dark
    rng = np.random.default_rng(0)
    M = warp_around(np.array([400.0, 300.0]), rng)
    thing = moved(np.array([[0, 400.0, 300.0, 10.0, 10.0]]), M)[0]
    assert np.abs(thing[1:3] - (SIDE_PX / 2 + 16)).max() <= ASIDE * SIDE_PX
    assert math.sqrt(abs(np.linalg.det(M[:, :2]))) * 10.0 <= thing[3] <= 13.0 * math.sqrt(abs(np.linalg.det(M[:, :2])))


def sampled_looks(seed: int, things: int = 4000, megapixels: int = 100, false: int = 6000) -> Looks:
    """Looks with normal logits: things around 1 with sigma 1, false peaks around -2 with sigma 1.

    Their log ratio is 3 x + 1.5 and the log of things over false peaks of a megapixel; that of all that are found.
    """
    rng = np.random.default_rng(seed)
    scores = [1.0 / (1.0 + np.exp(-rng.normal(m, 1.0, n))) for m, n in ((1.0, things), (-2.0, false))]
    score = np.concatenate(scores)
    is_true = np.arange(len(score)) < things
    picture = rng.integers(200, size=len(score))
    kind, size = np.zeros(len(score), np.int64), rng.uniform(6.0, 14.0, things)
    return Looks(
        picture, kind, score, is_true, picture[:things], kind[:things], score[:things], size,
        np.full(200, megapixels * 1e6 / 200), np.full(200, 100.0),
    )  # fmt: skip


def test_calibrated_ratios_are_those_of_the_truth_and_never_fall() -> None:
    looks = sampled_looks(0)
    bins = counted(looks, 0)
    assert 15 <= len(bins.edges) - 1 <= 40
    assert (np.diff(bins.log_ratio) > -1e-9).all()
    middle = np.clip((bins.edges[1:] + bins.edges[:-1]) / 2, 0.0, 0.999)
    x = np.log(middle / (1.0 - middle))
    true = 3.0 * x + 1.5 - math.log(6000 / 100)
    inner = (x > -1.5) & (x < 1.5)
    assert np.abs(bins.log_ratio - true)[inner].max() < 0.5
    assert np.abs((bins.log_ratio - true)[inner].mean()) < 0.15
    # How sure a bin is: about 1 / sqrt of the rarer of its peaks.
    sigma = log_ratio_sigma(looks, 0, bins.edges, np.random.default_rng(1))
    fewer = np.minimum(bins.true, bins.false)
    wide = fewer > 30
    assert wide.sum() >= 5
    assert (np.abs(np.log(sigma[wide] * np.sqrt(fewer[wide]))) < math.log(2.5)).all()
    assert 0.7 < bins.found.sum() <= 1.01


def test_pooling_keeps_the_counts_and_only_what_disagrees_is_pooled() -> None:
    assert isotonic(np.array([0.1, 0.3, 0.2, 0.9]), np.ones(4)).tolist() == [0, 1, 1, 2]
    true, false = smoothed(np.array([1.0, 30.0, 20.0, 90.0]), np.array([99.0, 70.0, 80.0, 0.0]))
    assert true + false == pytest.approx([100.0, 100.0, 100.0, 90.0])
    assert true[1] == pytest.approx(true[2])
    assert true.sum() == pytest.approx(141.0, abs=1.5)
    assert 0.0 < false[3] < 1.0  # no false peak in ninety is not that there is none


@pytest.mark.parametrize(("logits_more", "off"), [(0.0, 0.0), (0.5, 1.5)])
def test_reliability_shows_scores_that_other_pictures_do_not_bear_out(logits_more: float, off: float) -> None:
    bins, other = counted(sampled_looks(0), 0), sampled_looks(1)
    x = np.log(other.peak_score / (1.0 - other.peak_score)) + logits_more
    shifted = Looks(**{**vars(other), "peak_score": 1.0 / (1.0 + np.exp(-x))})
    rows = reliability(bins, shifted, 0)
    assert 5 <= len(rows) <= 10
    assert sum(row["true"] for row in rows) > 3900
    gaps = np.array([row["stated"] - row["measured"] for row in rows if row["false"] > 20])
    assert len(gaps) >= 4
    assert gaps.mean() == pytest.approx(off, abs=0.35)


def test_tables_state_what_is_missed_by_size_and_looks_are_chosen_by_picture() -> None:
    looks = sampled_looks(2)
    missed = looks.thing_size_px < 8.0
    score = np.where(missed & (np.arange(4000) % 2 == 0), 0.0, looks.thing_score)
    small = Looks(**{**vars(looks), "thing_score": score})
    (by_name,) = tables(small, small).values()
    sizes = by_name["by_size"]
    assert isinstance(sizes, list)
    assert [row["to_px"] for row in sizes] == [8.0, 16.0]
    assert 0.4 < sizes[0]["missed"] < 0.6
    assert sizes[1]["missed"] < 0.02
    both = joined(of_pictures(looks, np.arange(200) < 100), looks)
    assert len(both.pixels) == 400
    assert both.peak_picture.max() < 400
    assert (both.peak_picture >= 200).sum() == len(looks.peak_score)
    half = of_pictures(looks, np.arange(200) < 100)
    assert 0.4 < len(half.peak_score) / len(looks.peak_score) < 0.6
    assert half.pixels.sum() == pytest.approx(looks.pixels.sum() / 2)


def test_looks_at_shrunken_pictures_have_smaller_things_on_the_same_ground(tmp_path: Path) -> None:
    labelled(tmp_path, "1_60_90_0_00001", OBJECT.format("Person", 100, 96, 112, 108))
    (picture,) = read_all(tmp_path)

    def maps(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
        factor = grey.shape[1] / 320
        return maps_of(picture.things * [1, factor, factor, factor, factor], grey.shape[0] // 4, grey.shape[1] // 4)

    whole, half = look_at([picture], maps), look_at([picture], maps, shrink=2)
    assert whole.peak_true.tolist() == half.peak_true.tolist() == [True]
    assert whole.thing_size_px == pytest.approx(2 * half.thing_size_px)
    assert whole.ground_m2 == pytest.approx(half.ground_m2)
    assert whole.thing_score == pytest.approx([1.0])


def test_what_comes_again_is_found_where_pictures_overlap(tmp_path: Path) -> None:
    wide, shift = texture(9, 300, 420), np.array([-30.0, -12.0])  # the camera has moved right and down
    person, rock = np.array([150.0, 120.0]), np.array([210.0, 190.0])
    for name, off in (("1_60_90_0_00001", np.zeros(2)), ("1_60_90_0_00002", shift)):
        (left, top), at = (-off).astype(int), person + off
        box = OBJECT.format("Person", *(at - 5), *(at + 5))
        labelled(tmp_path, name, box, wide[top : top + 256, left : left + 320])
    pictures = read_all(tmp_path)

    def maps(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
        is_first = np.array_equal(grey, pictures[0].grey())
        off = np.zeros(2) if is_first else shift
        out = maps_of(np.array([[0, *(person + off), 10.0, 10.0]]))
        column, row = np.rint((rock + off) / 4).astype(int)
        out[0, row, column] = 0.6 if is_first else 0.5
        return out

    one, other = (seen(picture, maps) for picture in pictures)
    H = overlay(one.corners, other.corners)
    assert H is not None
    assert np.abs(H[:2, 2] - shift).max() < 1.0
    assert overlay(one.corners, corners_of(texture(77))) is None
    pairs = pairs_of(pictures, maps)
    assert [pair.moved_px for pair in pairs] == pytest.approx([np.hypot(*shift)] * 2, abs=1.5)
    assert [pair.things[0].tolist() for pair in pairs] == [[[1.0, 1.0]]] * 2
    assert pairs[0].false[0] == pytest.approx(np.array([[0.6, 0.5]]))
    assert pairs[1].false[0] == pytest.approx(np.array([[0.5, 0.6]]))
    assert len(false_places(one, other, H, 1)) == len(same_things(one, other, H, 1)) == 0


@pytest.mark.parametrize("rho", [0.0, 0.7])
def test_correlation_of_two_looks_is_the_sampled_one(rho: float) -> None:
    x = np.random.default_rng(4).multivariate_normal([-1.0, -1.0], [[1.0, rho], [rho, 1.0]], 2000)
    found = correlation(1.0 / (1.0 + np.exp(-x)))
    assert found == pytest.approx(rho, abs=0.06)
    assert correlation(np.full((9, 2), 0.5)) is None


@pytest.mark.parametrize(("shared", "lost"), [(0.0, 0.0), (0.6, 0.0), (0.8, 0.2)])
def test_what_looks_share_is_what_was_sampled(shared: float, lost: float) -> None:
    rng = np.random.default_rng(6)
    reach = np.array([0.7, 0.5, 0.3, 0.1, 0.0])
    x, own = rng.normal(size=(6000, 1)), rng.normal(size=(6000, 2))
    level = ndtr(math.sqrt(shared) * x + math.sqrt(1 - shared) * own)
    edges = 1.0 - np.minimum(reach / (1.0 - lost), 1.0)
    sampled = np.where(rng.random((6000, 2)) < lost, 0, np.searchsorted(edges, level, side="right"))
    assert np.bincount(sampled[:, 0], minlength=5) / 6000 == pytest.approx(-np.diff([1.0, *reach]), abs=0.03)
    found = fitted(reach, np.minimum(sampled, 4))
    assert found.shared == pytest.approx(shared, abs=0.08)
    assert found.lost == pytest.approx(lost, abs=0.06)
    assert found.places == 6000


def test_flights_differ_by_as_much_as_was_sampled() -> None:
    rng = np.random.default_rng(8)
    counts = rng.poisson(40.0 * rng.gamma(2.0, 0.5, 60))
    picture = np.repeat(np.arange(60), counts)
    score = rng.uniform(0.1, 0.3, len(picture))
    looks = Looks(
        picture, np.zeros(len(picture), np.int64), score, np.zeros(len(picture), bool), *[np.zeros(0, np.int64)] * 2,
        *[np.zeros(0)] * 2, np.full(60, 1e6), np.full(60, 100.0),
    )  # fmt: skip
    assert 1.2 < flights(looks, 0, np.arange(60)) < 3.5
    even = Looks(**{**vars(looks), "peak_picture": rng.integers(60, size=len(picture))})
    assert flights(even, 0, np.arange(60)) > 10.0


def test_without_pairs_more_looks_add_nothing() -> None:
    law = again(counted(sampled_looks(0), 0), [], 0)
    assert law["found_again"] == law["false_again"] == {"shared": pytest.approx(0.96, abs=0.03), "lost": 0.0}
