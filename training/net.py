"""The net: plain 3 x 3 convolutions down to a sixteenth of the picture, and back up to a quarter.

Few channels where the picture is large, and whole convolutions rather than separable ones: processors and OpenCV's dnn
have fast code for these, and they learn more in each hour.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from training.labelled_pictures import KINDS

OUTPUTS = len(KINDS) + 4
RARE = -4.6  # a cell is a thing's middle in one of a hundred cases, before anything is learned


def convolution(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )


class Residual(nn.Module):  # type: ignore[misc]
    """Two convolutions whose result is added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = convolution(channels, channels)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return functional.relu(x + self.second(self.first(x)))


class Net(nn.Module):  # type: ignore[misc]
    """(N, 2, H, W) to (N, 7, H/4, W/4): heat of each kind before the sigmoid, offset x and y, log size / 16 px."""

    def __init__(self, widths: tuple[int, int, int, int] = (8, 32, 64, 96)) -> None:
        super().__init__()
        half, quarter, eighth, sixteenth = widths
        self.quarter = nn.Sequential(convolution(2, half, 2), convolution(half, quarter, 2))
        self.eighth = nn.Sequential(convolution(quarter, eighth, 2), Residual(eighth), Residual(eighth))
        self.sixteenth = nn.Sequential(convolution(eighth, sixteenth, 2), Residual(sixteenth), Residual(sixteenth))
        self.up_to_eighth = nn.Conv2d(sixteenth, eighth, 1)
        self.joined = convolution(eighth, eighth)
        self.up_to_quarter = nn.Conv2d(eighth, quarter, 1)
        self.out = nn.Sequential(
            convolution(quarter, quarter), convolution(quarter, quarter), nn.Conv2d(quarter, OUTPUTS, 1)
        )
        nn.init.constant_(self.out[-1].bias[: len(KINDS)], RARE)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        quarter = self.quarter(x)
        eighth = self.eighth(quarter)
        deep = functional.interpolate(self.up_to_eighth(self.sixteenth(eighth)), scale_factor=2, mode="nearest")
        joined = self.joined(eighth + deep)
        return self.out(quarter + functional.interpolate(self.up_to_quarter(joined), scale_factor=2, mode="nearest"))


class Exported(nn.Module):  # type: ignore[misc]
    """A net whose heat has its sigmoid: what is written as ONNX."""

    def __init__(self, net: Net) -> None:
        super().__init__()
        self.net = net

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        maps = self.net(x)
        return torch.cat([torch.sigmoid(maps[:, : len(KINDS)]), maps[:, len(KINDS) :]], 1)
