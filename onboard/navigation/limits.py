"""Numbers with one meaning in several modules: how long things last, and from when on an error is more than chance."""

from __future__ import annotations

import math

MEMORY_NS = 120_000_000_000  # of telemetry
LATE_NS = 350_000_000  # that a report may be behind what it reports: for so long the last one is extrapolated
RECENT_NS = 2_000_000_000  # in which a filter corrects itself: slip is measured over it, and claims hold as long
PATIENCE_NS = 5_000_000_000  # after which nothing comes any more that was to come, and what lasts will go on
LONG_NS = 10_000_000_000  # after which what was has no effect any more: a fix that came and went, a turn

LIKELY_SIGMAS = 2.0  # an error is larger one time in twenty: no more than that may as well be chance
SURE_SIGMAS = 3.0
FALSE_ALARM = 1e-6  # share of the windows in order that a test over many states calls wrong
CLEAR = 2.0 * math.log(1e3)  # of chi-square, between two explanations of the same: a thousand to one
RARE = 2.0 * math.log(1e9)  # against one that is rare, beyond the states that it frees: a thousand million to one
MOST_OF = 0.5  # share of features or ground that is enough to judge all of them by
FORGOTTEN = 1.5  # factor on a sensor's variance, below which its contradiction of the others is over
