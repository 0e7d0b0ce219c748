"""An on-screen display as flight controllers and gimbals burn it into their pictures: text, a cross-hair, numbers."""

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

EDGE, LETTER = 5.0, 2.0  # strokes, px at 640 px width: a dark edge about light letters
LIGHT = 250.0


def _texts(seconds: float) -> list[tuple[str, float, float]]:
    """What is shown, and where it begins: shares of width and height."""
    altitude_m, speed_m_s = 120.0 + 3.0 * np.sin(seconds) + 0.1 * seconds, 17.0 + np.sin(0.7 * seconds)
    return [
        (f"ALT {altitude_m:6.1f}m", 0.03, 0.08),
        (f"SPD {speed_m_s:4.1f}", 0.03, 0.16),
        (f"HDG {int(10.0 * seconds) % 360:03d}", 0.42, 0.08),
        (f"{int(seconds) // 60:02d}:{seconds % 60.0:05.2f}", 0.72, 0.08),
        ("BAT 15.2V", 0.75, 0.95),
        ("GPS 17 SAT", 0.03, 0.95),
    ]


def _drawn(size_px: tuple[int, int], seconds: float, stroke: float) -> Picture:
    width, height = size_px
    scale = width / 640.0
    out = np.zeros((height, width), np.uint8)
    thickness = max(round(stroke * scale), 1)
    for text, x, y in _texts(seconds):
        at = round(x * width), round(y * height)
        cv2.putText(out, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.75 * scale, 255, thickness, cv2.LINE_AA)
    reach = 30.0 * scale
    for u, v in ((1.0, 0.0), (-1.0, 0.0), (0.0, 0.7), (0.0, -0.7)):
        ends = [(round(width / 2 + k * u * reach), round(height / 2 + k * v * reach)) for k in (0.5, 2.0)]
        cv2.line(out, *ends, 255, thickness, cv2.LINE_AA)
    return out


def displayed(image: Picture, seconds: float, opacity: float = 1.0) -> Picture:
    """A picture (H, W) with the display of a moment of the flight, `opacity` 0 to 1."""
    size = image.shape[1], image.shape[0]
    edge, letter = (opacity / 255.0 * _drawn(size, seconds, stroke) for stroke in (EDGE, LETTER))
    under = image * (1.0 - edge)
    out: Picture = (under * (1.0 - letter) + LIGHT * letter).astype(np.uint8)
    return out


def display_parts(size_px: tuple[int, int], seconds: float) -> NDArray[np.bool_]:
    """(H, W), true where the display of a moment is."""
    return _drawn(size_px, seconds, EDGE) > 100
