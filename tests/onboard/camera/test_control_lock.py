"""Controls: automatic modes off first, values on the driver's steps, everything read back, everything missing said."""

import errno

import pytest

from onboard.camera import control_lock
from onboard.camera.control_lock import Lock, Wanted
from onboard.camera.discovery import Identity
from onboard.camera.v4l2_device import Control
from tests.onboard.camera.fake_camera import FakeDevice, Plugged, World, failing

INACTIVE, READ_ONLY = 0x10, 0x4
MODES = ((0, "Auto Mode"), (1, "Manual Mode"), (2, "Shutter Priority Mode"))


def control(number: int, name: str, low: int, high: int, *, step: int = 1, default: int = 0, flags: int = 0) -> Control:
    return Control(number, name, 1, low, high, step, default, flags)


WEBCAM = [
    control(control_lock.AUTO_WHITE_BALANCE, "awb", 0, 1, default=1),
    control(control_lock.AUTOGAIN, "autogain", 0, 1, default=1),
    control(control_lock.GAIN, "gain", 0, 255, default=64),
    control(control_lock.WHITE_BALANCE_TEMPERATURE, "wb", 2800, 6500, step=10, default=4600),
    Control(control_lock.EXPOSURE_AUTO, "exposure auto", 3, 0, 3, 1, 3, 0, (MODES[1], (3, "Aperture Priority Mode"))),
    control(control_lock.EXPOSURE_ABSOLUTE, "exposure", 3, 2047, default=250),
    control(control_lock.FOCUS_ABSOLUTE, "focus", 0, 250, step=5),
    control(control_lock.FOCUS_AUTO, "focus auto", 0, 1, default=1),
]
AUTOS = {"exposure auto", "autogain", "awb", "focus auto"}
ALL = Wanted(exposure_us=2000.0, gain=20.0, focus=30.0, white_balance_k=5000.0)


class Driver(FakeDevice):
    """Values are refused while their automatic mode is on, as uvcvideo does."""

    automatic = {  # noqa: RUF012
        "gain": (control_lock.AUTOGAIN, 1),
        "wb": (control_lock.AUTO_WHITE_BALANCE, 1),
        "exposure": (control_lock.EXPOSURE_AUTO, 3),
        "focus": (control_lock.FOCUS_AUTO, 1),
    }

    def set_control(self, control: Control, value: int) -> None:
        if control.name in self.automatic:
            mode, on = self.automatic[control.name]
            known = {c.id: c for c in self.camera.controls}
            if mode in known and self.get_control(known[mode]) == on:
                raise failing(errno.EACCES)
        super().set_control(control, value)


def driver(available: list[Control] = WEBCAM) -> Driver:
    camera = Plugged(Identity("uvcvideo", "Cam", "usb-1"), controls=available)
    return Driver(World(video0=camera), "/dev/video0", camera)


def test_automatic_modes_are_off_before_any_value_is_set() -> None:
    device = driver()
    lock = Lock(device, ALL, 640)
    assert lock.complaints == []
    written = device.camera.writes
    assert {name for name, _ in written[:4]} == AUTOS
    assert dict(written) == {
        **{"awb": 0, "autogain": 0, "exposure auto": 1, "focus auto": 0},
        **{"gain": 20, "wb": 5000, "exposure": 20, "focus": 30},
    }


def test_nothing_is_touched_that_was_not_asked_for() -> None:
    device = driver()
    lock = Lock(device, Wanted(), 640)
    assert device.camera.writes == []
    # ... but a focus that moves by itself makes the calibration wrong.
    assert lock.complaints == ["the camera focuses by itself, which spoils its calibration: set camera.focus"]


def test_what_the_driver_does_not_have_is_reported() -> None:
    assert Lock(driver([]), ALL, 640).complaints == [
        "exposure 2000 us: the driver has no such control",
        "gain 20: the driver has no such control",
        "focus 30: the driver has no such control",
        "white balance 5000 K: the driver has no such control",
    ]


def test_a_value_out_of_range_is_clamped_and_reported() -> None:
    device = driver()
    (complaint,) = Lock(device, Wanted(exposure_us=500_000.0, focus=30.0), 640).complaints
    assert complaint == "exposure 500000 us is outside of the driver's range: exposure 3 to 2047, set to 2047"
    assert ("exposure", 2047) in device.camera.writes


def test_values_fall_on_the_drivers_steps() -> None:
    device = driver()
    assert Lock(device, Wanted(white_balance_k=5003.0, focus=32.0), 640).complaints == []
    assert ("wb", 5000) in device.camera.writes
    assert ("focus", 30) in device.camera.writes


def test_a_value_that_is_not_taken_is_reported() -> None:
    device = driver()
    device.automatic = {"gain": (control_lock.FOCUS_AUTO, 1)}  # refused for a reason of the driver's own
    (refused, read) = Lock(device, Wanted(gain=20.0), 640).complaints[1:]
    assert refused == "gain 20 is not taken (gain: Permission denied)"
    assert read == "gain: gain reads 64 instead of 20"


def test_a_value_taken_silently_and_not_kept_is_reported() -> None:
    device = driver()
    lock = Lock(device, Wanted(gain=20.0, focus=0.0), 640)
    assert lock.complaints == []
    device.camera.values[control_lock.GAIN] = 99
    device.camera.values[control_lock.AUTOGAIN] = 1
    assert lock.check() == ["autogain is on again", "gain: gain reads 99 instead of 20"]


def test_a_read_only_control_is_reported() -> None:
    available = [control(control_lock.GAIN, "gain", 0, 255, default=20, flags=READ_ONLY)]
    assert Lock(driver(available), Wanted(gain=20.0), 640).complaints == ["gain 20 is not taken (gain is read-only)"]


def test_a_sensor_that_counts_lines_is_set_in_microseconds() -> None:
    sensor = [
        control(control_lock.EXPOSURE_LINES, "exposure", 4, 2000, default=100),
        control(control_lock.HBLANK, "hblank", 0, 9999, default=160, flags=READ_ONLY),
        control(control_lock.PIXEL_RATE, "pixel rate", 0, 10**9, default=40_000_000, flags=READ_ONLY),
        control(control_lock.ANALOGUE_GAIN, "analogue gain", 16, 255),
    ]
    device = driver(sensor)
    assert Lock(device, Wanted(exposure_us=2000.0, gain=32.0), 640).complaints == []
    # A line takes (640 + 160) / 40 MHz = 20 us.
    assert device.camera.writes == [("exposure", 100), ("analogue gain", 32)]
    assert Lock(driver(sensor[:1]), Wanted(exposure_us=2000.0), 640).complaints == [
        "exposure 2000 us: the driver counts exposure in a unit it does not report"
    ]


def test_shutter_priority_stands_in_for_manual() -> None:
    mode = Control(control_lock.EXPOSURE_AUTO, "exposure auto", 3, 0, 3, 1, 0, 0, (MODES[0], MODES[2]))
    device = driver([mode, WEBCAM[5]])
    Lock(device, Wanted(exposure_us=2000.0), 640)
    assert ("exposure auto", 2) in device.camera.writes


def test_a_camera_that_goes_away_meanwhile_is_no_complaint() -> None:
    device = driver()
    del device.world.sockets["/dev/video0"]
    with pytest.raises(OSError) as caught:
        Lock(device, ALL, 640)
    assert caught.value.errno == errno.ENODEV
