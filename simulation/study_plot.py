"""The points of the error study's curves, and the curves as small PNG pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

TITLES = {
    "fig6": "Seed, figure 6: errors in the input (two views, 40 m)",
    "fig7": "Seed, figure 7: first camera turned from the direction of travel",
    "fig8": "Seed, figure 8: second camera turned against the first",
    "fig6_windows": "Errors in the input, for windows of views and more sensors",
    "fig7_windows": "Camera turned from the configured mount; 0.3 px, GPS 1 m",
    "fig8_windows": "Every second view turned; 0.3 px, GPS 1 m",
}
LABELS = {
    "pixel_noise_px": "pixel noise, one sigma (px)",
    "gps_noise_m": "GPS noise, one sigma per axis (m)",
    "heading": "heading (deg)",
    "pitch": "pitch (deg)",
    "roll": "roll (deg)",
}
FLOOR_M = 1e-3  # a logarithmic axis needs one; a millimetre is nothing here


@dataclass(frozen=True)
class Row:
    """One point of a curve: panel (axis or input), abscissa, curve (iterations or sensors), mean error in metres."""

    panel: str
    value: float
    curve: str
    mean_error_m: float


def plot(path: Path, name: str, rows: list[Row]) -> None:
    """Draw one figure: a panel for each input or axis, a curve for each number of iterations or sensor set."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 (slow, and only needed here)
    from matplotlib.figure import Figure  # noqa: PLC0415

    panels = list(dict.fromkeys(r.panel for r in rows))
    curves = list(dict.fromkeys(r.curve for r in rows))
    figure = Figure(figsize=(3.6 * len(panels), 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axis, panel in zip(axes, panels, strict=True):
        for curve in curves:
            points = [(r.value, max(r.mean_error_m, FLOOR_M)) for r in rows if (r.panel, r.curve) == (panel, curve)]
            axis.plot(*zip(*points, strict=True), marker="o", markersize=3, linewidth=1.2, label=curve)
        axis.set_xlabel(LABELS[panel])
        axis.set_yscale("linear" if name == "fig6" else "log")
        axis.grid(True, which="major", alpha=0.4)
    axes[0].set_ylabel("mean error of features (m)")
    axes[-1].legend(fontsize=7)
    figure.suptitle(TITLES[name], fontsize=10)
    figure.savefig(path, dpi=110)
