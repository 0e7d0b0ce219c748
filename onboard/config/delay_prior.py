"""The delay of a camera of which nothing is stated, by the form of `camera.device`."""

from __future__ import annotations

NETWORK_PRIOR_S = (0.5, 0.29)  # mean and one sigma of a delay anywhere between 0 and 1 s
LOCAL_PRIOR_S = (0.0, 0.1)
LOCAL_ELEMENTS = ("v4l2src", "libcamerasrc", "nvarguscamerasrc", "nvv4l2camerasrc")


def delay_prior(device: str, is_utc: bool = False) -> dict[str, float]:
    """Return its `latency_s` and `sigma_latency_s`.

    Where it is not known how long the sender's encoder and the link take, the delay may be anything up to a second.
    """
    is_network = device.startswith("rtsp") or (
        device.startswith("gst:") and not any(element in device for element in LOCAL_ELEMENTS)
    )
    latency_s, sigma_s = NETWORK_PRIOR_S if is_network and not is_utc else LOCAL_PRIOR_S
    return {"latency_s": latency_s, "sigma_latency_s": sigma_s}
