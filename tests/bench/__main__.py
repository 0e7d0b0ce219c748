"""`python -m tests.bench`: build the images, or run something of a checkout's in a guest with cameras."""

import argparse
import sys
from pathlib import Path

from tests.bench import cameras
from tests.bench.image.cache import folder, say
from tests.bench.image.host import BenchError
from tests.bench.image.root import CHECKOUT
from tests.bench.machine import GUEST_CHECKOUT, INSIDE, PYTHON, boot, images

EXAMPLES = """
python -m tests.bench build
python -m tests.bench run tools/try_camera.py --device /dev/video0
python -m tests.bench pytest tests/bench/inside -x
python -m tests.bench sh 'v4l2-ctl --list-devices; systemctl status'
"""


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench", epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("build", help="build what the cache has not")
    for name, what in (("run", "a Python script"), ("pytest", "tests of the checkout"), ("sh", "a line of shell")):
        command = commands.add_parser(name, help=f"{what}, in the guest")
        command.add_argument("--checkout", type=Path, default=CHECKOUT, help="what the guest sees at /mnt/checkout")
        command.add_argument("--timeout", type=float, default=300.0, metavar="S")
        command.add_argument("words", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    try:
        if given.command == "build":
            images()
            say(f"ready, in {folder()}")
            return 0
        before = {"run": [PYTHON], "pytest": [PYTHON, "-m", "pytest"], "sh": ["/bin/sh", "-c"]}[given.command]
        return _in_guest([*before, *given.words], given.checkout.resolve(), given.timeout)
    except BenchError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2


def _in_guest(argv: list[str], checkout: Path, timeout_s: float) -> int:
    with boot(checkout=checkout) as guest:
        cameras.load(guest)
        job = guest.start(argv, timeout_s=timeout_s, cwd=GUEST_CHECKOUT, env=INSIDE, on_text=_echo)
        return job.wait(timeout_s + 10.0).code


def _echo(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
