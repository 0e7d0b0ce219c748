"""`python -m tests.debian13`: put this checkout into a fresh Debian 13, and build the packages there.

python -m tests.debian13 COMMAND...    run a command there, in that checkout
"""

import shlex
import sys

from tests.bench.image.cache import say
from tests.bench.image.host import BenchError
from tests.debian13 import machine


def main(words: list[str]) -> int:
    """Return the exit code of the command; 2 if something is missing that cannot be had."""
    try:
        if words:
            return machine.call(shlex.join(words))
        machine.require()
        machine.refresh()
        for architecture in machine.ARCHITECTURES:
            machine.build_packages(architecture)
    except BenchError as error:
        print(f"test-debian13: {error}", file=sys.stderr)
        return 2
    say(f"ready, in {machine.ROOT}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
