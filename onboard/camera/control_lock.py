"""Exposure, gain, focus and white balance held where the configuration wants them.

Automatic modes go off first, because a driver refuses, or silently forgets, a value whose automatic mode is on. Every
value is read back. What the driver does not have, or does not take, is returned in words: a camera that sets its own
exposure is worth less, but not nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from errno import ENODEV

from onboard.camera.v4l2_device import Control, Device

# Control numbers: linux/v4l2-controls.h.
EXPOSURE_AUTO = 0x009A0901
EXPOSURE_ABSOLUTE = 0x009A0902  # 100 us
EXPOSURE_LINES = 0x00980911  # V4L2_CID_EXPOSURE: of sensors, in lines
HBLANK = 0x009E0902  # pixels
PIXEL_RATE = 0x009F0902  # pixels a second
AUTOGAIN = 0x00980912
GAIN = 0x00980913
ANALOGUE_GAIN = 0x009E0903
FOCUS_AUTO = 0x009A090C
FOCUS_ABSOLUTE = 0x009A090A
AUTO_WHITE_BALANCE = 0x0098090C
WHITE_BALANCE_TEMPERATURE = 0x0098091A

EXPOSURE_MANUAL, EXPOSURE_SHUTTER_PRIORITY = 1, 2
_DISABLED, _READ_ONLY = 0x1, 0x4


@dataclass(frozen=True)
class Wanted:
    """The values to hold; None: not touched."""

    exposure_us: float | None = None
    gain: float | None = None
    focus: float | None = None
    white_balance_k: float | None = None


@dataclass(frozen=True)
class _Setting:
    """One control and the value it shall have."""

    name: str
    control: Control
    value: int
    shown: str  # the configuration's own words, for messages


class Lock:
    """Holds the controls of one open device."""

    def __init__(self, device: Device, wanted: Wanted, width_px: int) -> None:
        """Raises OSError only where the device itself is gone: everything else ends in `complaints`."""
        self._device = device
        self._found = {control.id: control for control in device.controls() if not control.flags & _DISABLED}
        self.complaints: list[str] = []
        self._autos = list(self._automatic_modes(wanted))
        for control, off in self._autos:
            self._write(control, off, f"{control.name} cannot be switched off")
        self._settings = list(self._values(wanted, width_px))
        for setting in self._settings:
            self._write(setting.control, setting.value, f"{setting.name} {setting.shown} is not taken")
        self.complaints += self.check()

    def check(self) -> list[str]:
        """Read everything back; returns what is not as it was set."""
        complaints = []
        for control, off in self._autos:
            if self._read(control) not in {off, None}:
                complaints.append(f"{control.name} is on again")
        for setting in self._settings:
            now = self._read(setting.control)
            if now is not None and abs(now - setting.value) > max(setting.control.step, 1):
                complaints.append(f"{setting.name}: {setting.control.name} reads {now} instead of {setting.value}")
        return [text for text in complaints if text not in self.complaints]

    def _automatic_modes(self, wanted: Wanted) -> Iterable[tuple[Control, int]]:
        """The automatic modes in the way of what is wanted, with the value that ends each."""
        if wanted.exposure_us is not None and (mode := self._found.get(EXPOSURE_AUTO)):
            known = {index for index, _ in mode.menu}
            yield mode, EXPOSURE_MANUAL if EXPOSURE_MANUAL in known or not known else EXPOSURE_SHUTTER_PRIORITY
        for value, number in ((wanted.gain, AUTOGAIN), (wanted.white_balance_k, AUTO_WHITE_BALANCE)):
            if value is not None and (mode := self._found.get(number)):
                yield mode, 0
        if focus := self._found.get(FOCUS_AUTO):
            if wanted.focus is not None:
                yield focus, 0
            elif self._read(focus):
                # The focal length moves with the focus: the camera file would be right at one distance only.
                self.complaints.append("the camera focuses by itself, which spoils its calibration: set camera.focus")

    def _values(self, wanted: Wanted, width_px: int) -> Iterable[_Setting]:
        if wanted.exposure_us is not None:
            yield from self._exposure(wanted.exposure_us, width_px)
        yield from self._plain("gain", wanted.gain, (GAIN, ANALOGUE_GAIN))
        yield from self._plain("focus", wanted.focus, (FOCUS_ABSOLUTE,))
        yield from self._plain("white balance", wanted.white_balance_k, (WHITE_BALANCE_TEMPERATURE,), " K")

    def _exposure(self, exposure_us: float, width_px: int) -> Iterable[_Setting]:
        shown = f"{exposure_us:g} us"
        if absolute := self._found.get(EXPOSURE_ABSOLUTE):
            yield self._within("exposure", absolute, exposure_us / 100.0, shown)
        elif lines := self._found.get(EXPOSURE_LINES):
            line_us = self._line_time_us(width_px)
            if line_us is None:
                self.complaints.append(f"exposure {shown}: the driver counts exposure in a unit it does not report")
            else:
                yield self._within("exposure", lines, exposure_us / line_us, shown)
        else:
            self.complaints.append(f"exposure {shown}: the driver has no such control")

    def _line_time_us(self, width_px: int) -> float | None:
        blank, rate = self._found.get(HBLANK), self._found.get(PIXEL_RATE)
        if blank is None or rate is None:
            return None
        blank_px, rate_hz = self._read(blank), self._read(rate)
        return (width_px + blank_px) / rate_hz * 1e6 if blank_px is not None and rate_hz else None

    def _plain(self, name: str, value: float | None, numbers: tuple[int, ...], unit: str = "") -> Iterable[_Setting]:
        if value is None:
            return
        control = next((self._found[n] for n in numbers if n in self._found), None)
        if control is None:
            self.complaints.append(f"{name} {value:g}{unit}: the driver has no such control")
        else:
            yield self._within(name, control, value, f"{value:g}{unit}")

    def _within(self, name: str, control: Control, value: float, shown: str) -> _Setting:
        """The value on the driver's own steps; a complaint where that moves it by more than a step."""
        step = max(control.step, 1)
        steps = round((value - control.minimum) / step)
        possible = min(max(control.minimum + steps * step, control.minimum), control.maximum)
        if abs(possible - value) > step:
            self.complaints.append(
                f"{name} {shown} is outside of the driver's range: {control.name} "
                f"{control.minimum} to {control.maximum}, set to {possible}"
            )
        return _Setting(name, control, possible, shown)

    def _write(self, control: Control, value: int, complaint: str) -> None:
        if control.flags & _READ_ONLY:
            self.complaints.append(f"{complaint} ({control.name} is read-only)")
            return
        try:
            self._device.set_control(control, value)
        except OSError as error:
            if error.errno == ENODEV:
                raise
            self.complaints.append(f"{complaint} ({control.name}: {error.strerror})")

    def _read(self, control: Control) -> int | None:
        try:
            return self._device.get_control(control)
        except OSError as error:
            if error.errno == ENODEV:
                raise
            return None
