"""One window adjusted: an immutable request goes in, an outcome comes out. Pure computation.

The same request gives the same outcome in whatever thread it runs.
"""

from __future__ import annotations

from onboard.estimation.explanations import HEADINGS, begun_at, other_starts
from onboard.estimation.judge import is_far_worse, likelier
from onboard.estimation.stages import adjusted, from_one_start
from onboard.estimation.turn_profile import by_profile
from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Request


def adjust(request: Request) -> Outcome:
    """Solve a window; the status of the outcome is OK, or the reason why it has no result.

    From other starts too, where its pictures may have another explanation, (16.8). A likelier one has its own: those of
    a first solve that stopped short of its minimum are none of them.
    """
    first = from_one_start(request)
    best = _likeliest(request, first)
    if best is not first and best.solved is not None:
        best = _likeliest(request, best)
    judged, lower = by_profile(request.keyframes, best)
    elsewhere = None if lower is None else begun_at(HEADINGS, request, lower)
    if elsewhere is None:
        return judged
    preferred = likelier(request.keyframes, best, adjusted(elsewhere.window))
    return judged if preferred is best else by_profile(request.keyframes, preferred)[0]


def _likeliest(request: Request, found: Outcome) -> Outcome:
    """Return what other starts, than that of an outcome, lead to if it is likelier; a refusal if both fit."""
    best = found
    for other in other_starts(request, found):
        if not is_far_worse(best, other):
            best = likelier(request.keyframes, best, adjusted(other.window))
    return best
