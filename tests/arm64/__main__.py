"""`python -m tests.arm64`: fetch what the emulation needs into the cache, and build the packages to test."""

import sys
from concurrent.futures import ThreadPoolExecutor

from tests.arm64.emulation import build_packages, require, sysroot, testing
from tests.bench.image.cache import folder, say
from tests.bench.image.host import BenchError


def main() -> int:
    """Exit code 2 if something is missing that cannot be had."""
    try:
        require()
        sysroot()
        testing()
        with ThreadPoolExecutor(2) as threads:
            for done in [threads.submit(build_packages, architecture) for architecture in ("amd64", "arm64")]:
                done.result()
    except BenchError as error:
        print(f"test-arm64: {error}", file=sys.stderr)
        return 2
    say(f"ready, in {folder()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
