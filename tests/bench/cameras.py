"""The guest's cameras: vivid at /dev/video0, v4l2loopback at /dev/video10; vimc, for libcamera, where it is loaded."""

from collections.abc import Callable
from functools import partial

from tests.bench.machine import Machine
from tests.waiting import eventually

PICTURES = 20
"""Pictures after which a camera that was plugged in is known to give new ones, or the same one for ever."""
DECIDED_WITHIN_S = 180.0
PLUGGED_IN_AT_MOST = 3

VIVID = "/dev/video0"
LOOPBACK = "/dev/video10"
SETTLE = "udevadm settle --timeout=10"
# vimc's pattern stands still without the time in it; small pictures have room for nothing else.
SHOW_TIME = (
    'for n in /sys/class/video4linux/v4l-subdev*; do grep -qx "Sensor B" $n/name || continue'
    "; v4l2-ctl -d /dev/${n##*/} -c show_information=1; done"
)


def load(guest: Machine) -> None:
    load_vivid(guest, 0)
    load_loopback(guest, 10)


def load_vivid(guest: Machine, number: int) -> None:
    """One capture device with one webcam input, /dev/video<number>.

    `timestamp_source=1` stamps at the start of exposure, as a camera does; vivid's default lies a frame in the future.
    """
    guest.shell(
        f"modprobe vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0x00 vid_cap_nr={number}; {SETTLE}"
        f"; v4l2-ctl -d /dev/video{number} -c timestamp_source=1"
    )


def load_loopback(guest: Machine, number: int) -> None:
    """A camera that is what is played into it, /dev/video<number>."""
    words = "devices=1 card_label=uavcam exclusive_caps=1 max_buffers=8"
    guest.shell(f"modprobe v4l2loopback {words} video_nr={number}; {SETTLE}")


def load_vimc(guest: Machine) -> None:
    """A sensor with its processing, as libcamera knows how to drive: `libcamera:platform/vimc.0 Sensor B`."""
    guest.shell(f"modprobe vimc; {SETTLE}; {SHOW_TIME}")


def plug_vimc(guest: Machine, is_in: bool) -> None:
    """Take it away from whoever reads it, or put it back: a new sensor, whose settings are the driver's own again."""
    guest.shell(f"echo vimc.0 >/sys/bus/platform/drivers/vimc/{'bind' if is_in else 'unbind'}; {SETTLE}")
    if is_in:
        guest.shell(SHOW_TIME)


def plug_in_until_new(pictures: Callable[[], tuple[float, float]], plug: Callable[[bool], None]) -> int:
    """Plug vimc in, and return how often that was needed until new pictures came. AssertionError if they never do.

    Now and then the kernel's vimc gives one picture for ever after it is plugged in again. `pictures` counts those so
    far, the new ones and the repeated ones.
    """
    for times in range(1, PLUGGED_IN_AT_MOST + 1):
        new, repeated = pictures()
        plug(True)
        eventually(partial(_have_come, pictures, new + PICTURES, repeated + PICTURES), DECIDED_WITHIN_S)
        if pictures()[0] >= new + PICTURES:
            return times
        plug(False)
    raise AssertionError("no new pictures of a camera that was plugged in again")


def _have_come(pictures: Callable[[], tuple[float, float]], new: float, repeated: float) -> bool:
    new_now, repeated_now = pictures()
    return new_now >= new or repeated_now >= repeated


def unplug_vivid(guest: Machine, number: int) -> None:
    """Pull /dev/video<number> out from under whoever reads it, and take it away.

    The first by itself is not enough: vivid plugs itself in again when its last reader has closed it.
    """
    set_control(guest, f"/dev/video{number}", "disconnect", 1)
    unload(guest, "vivid")


def unload(guest: Machine, module: str) -> None:
    """Take a driver away with its devices, as soon as no one holds them open (5 s at most)."""
    guest.shell(f"for _ in $(seq 100); do rmmod {module} 2>/dev/null && exit 0; sleep 0.05; done; rmmod {module}")


def set_control(guest: Machine, device: str, name: str, value: int) -> None:
    guest.shell(f"v4l2-ctl -d {device} -c {name}={value}")
