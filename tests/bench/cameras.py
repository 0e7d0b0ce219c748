"""The guest's cameras: vivid at /dev/video0, v4l2loopback at /dev/video10."""

from __future__ import annotations

from tests.bench.machine import Machine

VIVID = "/dev/video0"
LOOPBACK = "/dev/video10"

# One capture device with one webcam input; `timestamp_source=1` stamps at the start of exposure, as a camera does
# (its default lies a frame in the future).
_LOAD_VIVID = f"""
modprobe vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0x00
udevadm settle --timeout=10
v4l2-ctl -d {VIVID} -c timestamp_source=1
"""
_LOAD_LOOPBACK = """
modprobe v4l2loopback devices=1 video_nr=10 card_label=uavcam exclusive_caps=1 max_buffers=8
udevadm settle --timeout=10
"""


def load(guest: Machine) -> None:
    """Both cameras."""
    guest.shell(_LOAD_VIVID + _LOAD_LOOPBACK)
