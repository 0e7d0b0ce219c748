"""Pictures that are mirror images of what the camera sees, as a flip in its settings or a mirror in its way makes them.

In level flight they are as rigid as true ones: they show the ground's mirror image, and no residual of features reveals
it. But they roll and yaw the other way than the vehicle does. So a window is solved with its pictures flipped, left for
right and upside down, until one of the three is clearly the likeliest. (19.6)
"""

from __future__ import annotations

from dataclasses import replace

from onboard.estimation.explanations import flipped
from onboard.estimation.judge import excess_over
from onboard.estimation.keyframe import have_attitude
from onboard.estimation.moved_optics import MAX_VARIANCE, is_attitude_contradicted
from onboard.estimation.window_problem import Weighed

ACROSS, UPSIDE_DOWN = 0, 1  # the image axis that is flipped


def shown(weighed: Weighed) -> bool | None:
    """Return whether a window shows its pictures to be mirror images; None if neither. `weighed`: its first solve."""
    request = weighed.window.request
    if request.is_mirrored is False or request.is_mount_open or not have_attitude(request.keyframes):
        return None
    # A sensor that was found to fail may have been innocent.
    noise, factors = weighed.noise, weighed.noise.factors
    if factors.groups:
        weighed = weighed.again(replace(noise, factors=replace(factors, groups={})))
    flips = [each for axis in (ACROSS, UPSIDE_DOWN) if (each := flipped(weighed, axis)) is not None]
    others = [each.window.weighed(weighed.noise, each.start) for each in flips]
    if any(_is_likelier(other, weighed) for other in others):
        return True
    own = weighed.solution
    return False if all(excess_over(other.solution, own).is_clear() for other in others) else None


def _is_likelier(mirrored: Weighed, own: Weighed) -> bool:
    """Return whether mirror images are clearly likelier, and explain pictures and attitudes.

    What is wrong otherwise, a lens that zoomed or a heading, fits no better for being flipped. Gusts that tilt the
    aircraft to and fro may, where attitudes are half a period off: until a turn, they are then refused as well.
    """
    excess = excess_over(own.solution, mirrored.solution)
    return excess.is_clear() and excess.variance < MAX_VARIANCE and not is_attitude_contradicted(mirrored)
