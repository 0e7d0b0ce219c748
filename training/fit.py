"""Training: losses, one cycle of the learning rate over the time given, and a running mean of the weights."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from onboard.spots.thing_net import STRIDE
from training.crops import Crop, Crops
from training.labelled_pictures import KINDS, Labelled
from training.net import Net
from training.net_input import level_of, net_input
from training.peaks import judge, peaks_of
from training.targets import targets_of

BATCH = 24
RATE, WARM_UP, LAST_RATE, DECAY = 3e-3, 0.03, 0.003, 1e-3
LONGEST_STEP = 5.0  # norm of a gradient
MEAN_OF_STEPS = 1000  # the running mean of the weights
KIND_WEIGHTS = (1.5, 1.0, 1.0)
SHAPE_WEIGHT = 0.5
EACH_LOOK, LOOKED_AT, FALSE_FROM = 1500, 200, 0.15  # steps between searches for false peaks; pictures; score
EACH_REPORT = 100  # steps


class Batch(NamedTuple):
    """Inputs (N, 2, S, S), heat (N, 3, s, s), where labels count (N, 1, s, s); cells (M, 3), shapes (M, 4)."""

    inputs: torch.Tensor
    heat: torch.Tensor
    counts: torch.Tensor
    cells: torch.Tensor
    shapes: torch.Tensor


@dataclass(frozen=True)
class Progress:
    """The state of training at a report: its share of the time, steps, and the mean loss since the last report."""

    share: float
    steps: int
    loss: float


def batch_of(crops: list[Crop]) -> Batch:
    side = crops[0].counts.shape[0] // STRIDE
    targets = [targets_of(crop.things, side, side) for crop in crops]
    middle = STRIDE // 2
    cells = [np.c_[np.full(len(t.cells), i), t.cells] for i, t in enumerate(targets)]
    return Batch(
        inputs=torch.from_numpy(np.stack([c.channels for c in crops])).to(memory_format=torch.channels_last),
        heat=torch.from_numpy(np.stack([t.heat for t in targets])),
        counts=torch.from_numpy(np.stack([c.counts[None, middle::STRIDE, middle::STRIDE] for c in crops])),
        cells=torch.from_numpy(np.vstack(cells)),
        shapes=torch.from_numpy(np.vstack([t.shapes for t in targets])),
    )


def loss_of(maps: torch.Tensor, batch: Batch) -> torch.Tensor:
    """Return the focal loss of the heat (CenterNet: Zhou et al. 2019, equation 1) and the mean error of the shapes."""
    logits, weights = maps[:, : len(KINDS)], torch.tensor(KIND_WEIGHTS)[None, :, None, None]
    heat = torch.sigmoid(logits)
    at_middle = batch.heat > 0.999
    hit = (1.0 - heat) ** 2 * functional.logsigmoid(logits)
    off = (1.0 - batch.heat) ** 4 * heat**2 * functional.logsigmoid(-logits) * batch.counts
    focal = -(weights * torch.where(at_middle, hit, off)).sum() / at_middle.sum().clamp(min=1)
    n, row, column = batch.cells.T
    return focal + SHAPE_WEIGHT * functional.l1_loss(maps[n, len(KINDS) :, row, column], batch.shapes)


def rate_at(share: float) -> float:
    """Return the learning rate after a share of the time: a warm-up, then half a cosine."""
    return RATE * min(1.0, share / WARM_UP) * (LAST_RATE + 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0))))


class Fit:
    """A net in training: `net` takes the steps, `mean` is the running mean of its weights, which is what is kept."""

    def __init__(self, crops: Crops, seed: int) -> None:
        torch.manual_seed(seed)
        self.crops = crops
        self.net = Net().to(memory_format=torch.channels_last)
        self.mean = copy.deepcopy(self.net).eval()
        self.steps = 0
        self._rng = np.random.default_rng(seed + 1)
        self._optimiser = torch.optim.AdamW(self.net.parameters(), RATE, weight_decay=DECAY)

    def run(self, seconds: float, report: Callable[[Progress], None]) -> None:
        """Train for so long; batches are made by a second thread, in the same order each time."""
        start = time.monotonic()
        losses: list[float] = []
        with ThreadPoolExecutor(1) as maker:
            coming = maker.submit(self._batch)
            while (share := (time.monotonic() - start) / seconds) < 1.0:
                batch, coming = coming.result(), maker.submit(self._batch)
                losses.append(self._step(batch, rate_at(share)))
                if self.steps % EACH_LOOK == 0:
                    self.crops.false_peaks = self._false_peaks()
                if self.steps % EACH_REPORT == 0:
                    report(Progress(share, self.steps, float(np.mean(losses))))
                    losses.clear()

    def _batch(self) -> Batch:
        return batch_of([self.crops.draw() for _ in range(BATCH)])

    def _step(self, batch: Batch, rate: float) -> float:
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        with torch.autocast("cpu", torch.bfloat16):
            maps = self.net(batch.inputs)
        loss = loss_of(maps.float(), batch)
        self._optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), LONGEST_STEP)
        self._optimiser.step()
        self.steps += 1
        share = 1.0 / min(MEAN_OF_STEPS, self.steps / 8.0 + 1.0)
        with torch.no_grad():
            for mean, now in zip(self.mean.state_dict().values(), self.net.state_dict().values(), strict=True):
                if mean.dtype.is_floating_point:
                    mean.lerp_(now, share)
                else:
                    mean.copy_(now)
        return float(loss.detach())

    def _false_peaks(self) -> list[tuple[int, float, float]]:
        """Return (picture, u, v) of false peaks in some pictures of the training."""
        found = []
        chosen = self._rng.choice(len(self.crops.pictures), min(LOOKED_AT, len(self.crops.pictures)), replace=False)
        for i in chosen.tolist():
            picture = self.crops.pictures[i]
            peaks = peaks_of(maps_by(self.mean, picture), FALSE_FROM)
            judged = judge(peaks, picture.things, picture.left_open)
            wrong = judged.counts & (judged.thing < 0)
            found += [(i, float(u), float(v)) for u, v in peaks.middle_px[wrong]]
        return found


def maps_by(net: Net, picture: Labelled) -> NDArray[np.float32]:
    """Return a net's maps (7, H/4, W/4) of a picture, the heat with its sigmoid."""
    grey = picture.grey()
    inputs = torch.from_numpy(net_input(grey, level_of(grey)))[None].to(memory_format=torch.channels_last)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        maps: NDArray[np.float32] = net(inputs)[0].float().numpy()
    maps[: len(KINDS)] = 1.0 / (1.0 + np.exp(-maps[: len(KINDS)]))
    return maps
