"""A digest of all that comes out of each flight of the ablation: what a change of the code's shape must leave alone.

    python -m tests.digests [--only "climb"] >before.txt; (change) python -m tests.digests | diff before.txt -

One draw of every recorded and sampled flight of `ablation_scenes` through the pipeline. A line holds the digest
of all sets' bytes in the order in which they came, how many there were, and how many of them are OK. Bytes are the same
on the same machine with the same libraries only, so no line of it is kept.
"""

import argparse
from hashlib import sha256

from benchmarks.ablation_scenes import ORDINARY, Trial, own
from benchmarks.sampled_flight import every_set
from contract.feature_set import Status
from contract.wire.codec import encode


def trials() -> list[Trial]:
    """Return every flight of the ablation once, by its name."""
    every = {trial.name: trial for trial in ORDINARY}
    for own_of in own().values():
        every |= {trial.name: trial for trial in own_of}
    return list(every.values())


def line(trial: Trial) -> str:
    """Return the digest of a flight, the number of its sets and of those that are OK, and its name."""
    flight = trial.flight(trial.seed)
    sets = list(every_set(trial.pipeline(flight), flight.events()))
    digest = sha256(b"".join(encode(out) for out in sets)).hexdigest()[:16]
    solved = sum(out.status is Status.OK for out in sets)
    return f"{digest} {len(sets):4d} sets, {solved:4d} OK  {trial.name}"


def main() -> None:
    """Print a line for every flight."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="words of the flights' names")
    only = parser.parse_args().only
    for trial in (trial for trial in trials() if only in trial.name):
        print(line(trial), flush=True)


if __name__ == "__main__":
    main()
