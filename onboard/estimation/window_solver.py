"""One window adjusted: an immutable request goes in, an outcome comes out. Pure computation.

The same request gives the same outcome in whatever thread it runs.
"""

from __future__ import annotations

from dataclasses import replace

from contract.feature_set import Status
from onboard.estimation.explanations import HEADINGS, begun_at, other_starts
from onboard.estimation.judge import is_far_worse, likelier
from onboard.estimation.moved_optics import MOVED
from onboard.estimation.stages import adjusted, from_one_start
from onboard.estimation.turn_profile import by_profile
from onboard.estimation.window_acceptance import off_terrain
from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Request


def adjust(request: Request) -> Outcome:
    """Solve a window; the status of the outcome is OK, or the reason why it has no result.

    From other starts too, where its pictures may have another explanation, (16.8). A likelier one has its own: those of
    a first solve that stopped short of its minimum are none of them.

    Where a window has no result over its terrain model, it is solved without too: ground that all else shows elsewhere
    leaves that model in doubt. One that no window has agreed with is left out then; of one that some have, nothing
    shows which of the two is wrong: the lens may have zoomed, or the ground move as a whole. (16.16)
    """
    if request.terrain is None:
        return _from_all_starts(request)
    if request.is_terrain_left_out:
        return _without_terrain(request)
    over = _from_all_starts(request)
    if over.status not in (Status.POOR_FIT, *MOVED):
        return over
    alone = _without_terrain(request)
    if not alone.terrain_doubt:
        return over
    if request.has_terrain_agreed:
        return replace(over, status=Status.POOR_FIT, reason=alone.terrain_doubt, terrain_doubt=alone.terrain_doubt)
    return alone


def _without_terrain(request: Request) -> Outcome:
    """Solve a window without its terrain model, and compare that with the ground it shows."""
    alone = _from_all_starts(replace(request, terrain=None))
    solved = alone.solved
    doubt = None if solved is None else off_terrain(request.config, request.terrain, solved.solution, solved.good)
    return replace(alone, terrain_doubt=doubt or "")


def _from_all_starts(request: Request) -> Outcome:
    """Solve a window from all starts, over its terrain model if it has one."""
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
