"""The way from labelled pictures to a file with a net."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from training.crops import SIDE_PX, Crops
from training.export import export
from training.fit import BATCH, Fit, Progress
from training.labelled_pictures import Split


def trained(data: Split, path: Path, minutes: float, seed: int) -> str:
    """Train for so many minutes and write the net to `path`; its weights so far are kept next to it.

    Returns how it was trained, for the model card.
    """
    # More threads wait for each other wherever another program wants a core, for longer than they save.
    torch.set_num_threads(1)
    fit = Fit(Crops(data.training, np.random.default_rng(seed)), seed)

    def report(progress: Progress) -> None:
        print(f"{progress.share:6.1%}  step {progress.steps}  loss {progress.loss:.3f}", flush=True)
        torch.save(fit.mean.state_dict(), path.with_suffix(".pt"))

    fit.run(60.0 * minutes, report)
    off = export(fit.mean, path, data.calibration[0].grey())
    print(f"{fit.steps} steps; OpenCV is {off:.1g} off PyTorch", flush=True)
    return (
        f"from nothing, with `python -m training.thermal_things` (seed {seed}): {fit.steps:,} steps of {BATCH} crops of"
        f" {SIDE_PX} x {SIDE_PX} px from {len(data.training):,} pictures of other flights, {minutes:g} minutes of one"
        " core."
    )
