"""Advice to an operator on a refused click, in a sentence for each reason."""

from __future__ import annotations

from contract.feature_set import Status

ADVICE: dict[Status, str] = {
    Status.OK: "",
    Status.STARTING: "wait until the aircraft has moved some metres",
    Status.LOW_PARALLAX: "fly on sideways, or step to a picture taken a little earlier or later",
    Status.OUTSIDE: "step to a picture that shows the place nearer to its middle",
    Status.ABOVE_HORIZON: "click lower in the picture, or point the camera further down",
    Status.STALE: "freeze the picture and click it, or wait for the link",
    Status.UNSYNCHRONISED: "step to an earlier picture; the aircraft is learning the autopilot's clock again",
    Status.TURNING: "step to a picture before or after the turn",
    Status.NO_GPS: "step to a picture taken while there was GPS",
    Status.FEATURELESS: "step to a picture with more texture: edges, paths, trees",
    Status.POOR_FIT: "step to an earlier or later picture",
    Status.UNCERTAIN: "step to a picture taken nearer to the place",
    Status.CAMERA_LOST: "step to an earlier picture; the camera is being looked for",
    Status.UNKNOWN_FRAME: "step to another picture: this one did not arrive",
    Status.BAD_PICTURE: "step to an earlier or later picture",
    Status.OUTSIDE_CALIBRATION: "step to a picture that shows the place nearer to its middle",
    Status.REPETITIVE: "step to a picture with the field's border, a path or trees in it",
    Status.STABILISED: "step to an earlier picture; the camera's stabilisation must be switched off",
    Status.ZOOMED: "step to a picture taken before the zoom, or have the lens set back",
    Status.MIRRORED: "have the camera's flip (or mirror) switched off: all its pictures are mirror images",
    Status.STRETCHED: "have the camera calibrated at this picture size: all its pictures are stretched along one side",
}
