"""The net as a file that OpenCV's dnn reads, and the check that it returns there what it returned in training."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import torch

from training.labelled_pictures import Grey
from training.net import Exported, Net
from training.net_input import level_of, net_input
from training.run_onnx import OnnxNet

OPSET = 17
MOST_DIFFERENCE = 1e-3


def export(net: Net, path: Path, check: Grey) -> float:
    """Write a net as ONNX, for pictures of any size; return how far it is off in OpenCV on one picture.

    Raises ValueError where that is more than `MOST_DIFFERENCE`.
    """
    whole = Exported(copy.deepcopy(net).float().to(memory_format=torch.contiguous_format)).eval()
    inputs = torch.from_numpy(net_input(check, level_of(check)))[None]
    axes = {"picture": {2: "h", 3: "w"}, "maps": {2: "h4", 3: "w4"}}
    torch.onnx.export(
        whole, (inputs,), str(path), input_names=["picture"], output_names=["maps"], opset_version=OPSET,
        dynamic_axes=axes, dynamo=False,
    )  # fmt: skip
    with torch.no_grad():
        wanted = whole(inputs)[0].numpy()
    off = float(np.abs(OnnxNet(path).maps(check) - wanted).max())
    if off > MOST_DIFFERENCE:
        raise ValueError(f"OpenCV returns maps that are {off:.2g} off what PyTorch returns: {path} is of no use")
    return off
