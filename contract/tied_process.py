"""A program that ends when the one that started it does, however that ends: the kernel sends the signal."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

# Becomes the program after it has asked for the signal: 1 is PR_SET_PDEATHSIG. The standard library alone, isolated.
_LAUNCHER = (
    "import ctypes, os, sys\n"
    "ctypes.CDLL(None).prctl(1, int(sys.argv[2]), 0, 0, 0)\n"
    "if os.getppid() != int(sys.argv[1]): sys.exit(1)\n"
    "try: os.execvp(sys.argv[3], sys.argv[3:])\n"
    "except OSError as error: print(f'{sys.argv[3]}: {error.strerror}', file=sys.stderr); sys.exit(127)\n"
)
NOT_THERE = 127  # exit status where the program cannot be started


def tied(command: Sequence[str], number: int) -> list[str]:
    """The command that runs `command` and gets signal `number` when the thread that starts it ends."""
    return [sys.executable, "-I", "-S", "-c", _LAUNCHER, str(os.getpid()), str(number), *command]
