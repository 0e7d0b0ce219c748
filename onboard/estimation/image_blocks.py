"""Blocks of states that move image coordinates: the camera's own, rows read in turn, and optics that change. (19.1)

Every block adds to the predicted coordinates of a picture a Jacobian times its states. Which blocks a window has is in
its `Layout`; a hypothesis about the optics is one of them switched on. All pictures share the camera's states, of the
other blocks each has its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.estimation.camera_states import COUNT
from onboard.estimation.factors import RATES, READ, SHIFT, STRETCH, WAVES, ZOOM, Layout, State
from onboard.estimation.rolling_shutter import Sweep
from onboard.geometry.camera_errors import by_states

Array = NDArray[np.float64]

OPEN = 0.3  # one sigma of a picture's shift (focal lengths), zoom and stretch (logarithms): as good as free
OPEN_READOUT_S = 0.05  # and of its readout: no camera's is much longer


@dataclass(frozen=True, eq=False)
class ImageBlock:
    """M states of each of K pictures."""

    columns: NDArray[np.intp]  # (K, M) of the reduced system; pictures that share a state share its column
    jacobian: Callable[[State, Array, Array], Array]  # (K, M, 2, P) at a state, predicted (K, 2, P) and depth (K, P)
    values: Callable[[State], Array]  # (K, M) of the states
    sigma: float | None = None  # of each state's prior, whose mean is 0; None: `SharedPrior` holds them


def blocks_of(
    layout: Layout, camera: Camera | None, camera_taken: Array, sweep: Sweep | None
) -> tuple[ImageBlock, ...]:
    """The blocks of a layout. `camera` and the states (C,) that it has already, where its states are estimated."""
    own: dict[str, tuple[Callable[[Array], Array], float]] = {
        SHIFT: (_by_shift, OPEN),
        ZOOM: (_by_zoom, OPEN),
        STRETCH: (_by_stretch, OPEN),
    }
    if sweep is not None:
        own[RATES] = sweep.by_rate, sweep.sigma_rate_rad_s
        own[WAVES] = sweep.by_wave, sweep.sigma_wave_rad
    blocks = {name: _own(layout, name, *own[name]) for name in layout.blocks if name != READ}
    if READ in layout.blocks:
        assert sweep is not None
        blocks[READ] = _read(layout, sweep)
    shared = () if camera is None else (_camera(layout, camera, camera_taken, sweep),)
    return *shared, *(blocks[name] for name in layout.blocks)


def _own(layout: Layout, name: str, by_state: Callable[[Array], Array], sigma: float) -> ImageBlock:
    part = layout.part(name)
    return ImageBlock(
        layout.by_picture[:, part], lambda state, predicted, depth: by_state(predicted), lambda s: s.own[:, part], sigma
    )


def _read(layout: Layout, sweep: Sweep) -> ImageBlock:
    """A readout of each picture's own beyond the one that is known, (18.2)."""
    part = layout.part(READ)
    return ImageBlock(
        layout.by_picture[:, part],
        lambda state, predicted, depth: sweep.by_readout(state.R_cam_enu, predicted, depth)[:, None],
        lambda state: state.own[:, part],
        OPEN_READOUT_S,
    )


def _camera(layout: Layout, camera: Camera, taken: Array, sweep: Sweep | None) -> ImageBlock:
    """(15.2); the readout's state by (18.2), where rates of their own turn the pictures already by travel alone."""
    has_readout, turns = layout.camera_states > COUNT, RATES not in layout.blocks

    def jacobian(state: State, predicted: Array, depth: Array) -> Array:
        # Where points are predicted, not where they were measured: a larger focal length must not shrink the noise.
        moved = -by_states(camera, predicted[:, 0], predicted[:, 1])
        if sweep is None or not has_readout:
            return moved
        by_readout = sweep.by_readout(state.R_cam_enu, predicted, depth, turns=turns)
        return np.concatenate([moved, by_readout[:, None]], axis=1)

    columns = np.tile(np.arange(layout.size)[layout.camera], (layout.keyframes, 1))
    return ImageBlock(columns, jacobian, lambda state: np.tile(state.camera - taken, (layout.keyframes, 1)))


def _by_shift(predicted: Array) -> Array:
    """d x / d (principal point) (K, 2, 2, P), counted from the first picture's."""
    out = np.zeros((len(predicted), 2, *predicted.shape[1:]))
    out[1:, 0, 0] = out[1:, 1, 1] = 1.0
    return out


def _by_zoom(predicted: Array) -> Array:
    """d x / d (logarithm of the focal length) (K, 1, 2, P)."""
    return predicted[:, None]


def _by_stretch(predicted: Array) -> Array:
    """d x / d (logarithm of the picture's width, its height as it is) (K, 1, 2, P)."""
    out = predicted[:, None].copy()
    out[:, :, 1] = 0.0
    return out
