"""A box around a program that reads what strangers send: it cannot open the files that are closed to it.

A program of its own, run as a script by the system's Python before the one that is named after `--`:

    python3 -I box.py CLOSED... -- COMMAND...

Nothing of this project is imported. By Landlock, which needs no privilege and holds for all that the command starts: it
may read and write what its user may, but for the closed files and folders, and not the memory of processes outside; of
the environment it gets what KEPT names. The network stays open: its pictures may come from there. A kernel
without Landlock (before 5.13) is reported on the error stream, and the command runs with its environment cleared alone.
"""

from __future__ import annotations

import ctypes
import os
import struct
import sys

KEPT = ("PATH", "HOME", "LANG", "LC_", "TZ", "TMPDIR", "XDG_", "GST_", "LIBCAMERA_", "LD_LIBRARY_PATH")
CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system calls; the same on x86-64 and aarch64
BENEATH = 1
EVERY_RIGHT = (1 << 13) - 1  # of the first version: execute, write, read, list, remove and make
OF_FILES = 0b111  # execute, write, read
PR_SET_NO_NEW_PRIVS = 38


def _call(libc: ctypes.CDLL, *words: object) -> int:
    """Return what a system call gives. Raises OSError."""
    result = int(libc.syscall(*words))
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result


def open_paths(closed: set[str], folder: str = "/") -> list[str]:
    """Return the files and folders that together hold all but the closed ones: as few as there can be."""
    if folder in closed:
        return []
    if not any(path.startswith(folder.rstrip("/") + "/") for path in closed):
        return [folder]
    try:
        children = sorted(entry.path for entry in os.scandir(folder) if not entry.is_symlink())
    except OSError:
        return []  # closed to us, too
    return [path for child in children for path in open_paths(closed, child)]


def enter(closed: set[str]) -> None:
    """Shut this process and all that it starts out of some files and folders, for good. Raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    asked = ctypes.create_string_buffer(struct.pack("=Q", EVERY_RIGHT))
    ruleset = _call(libc, CREATE_RULESET, asked, ctypes.c_size_t(8), 0)
    for path in open_paths({os.path.realpath(path) for path in closed}):
        try:
            there = os.open(path, os.O_PATH | os.O_CLOEXEC)
        except OSError:
            continue  # gone by now, or closed to us
        rights = EVERY_RIGHT if os.path.isdir(path) else OF_FILES  # noqa: PTH112
        rule = ctypes.create_string_buffer(struct.pack("=Qi", rights, there))
        _call(libc, ADD_RULE, ruleset, BENEATH, rule, 0)
        os.close(there)
    if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "no new privileges")
    _call(libc, RESTRICT_SELF, ruleset, 0)
    os.close(ruleset)


def main(arguments: list[str]) -> None:
    """Enter the box and become the command."""
    at = arguments.index("--")
    closed, command = set(arguments[:at]), arguments[at + 1 :]
    environment = {key: value for key, value in os.environ.items() if key.startswith(KEPT)}
    try:
        enter(closed)
    except OSError as error:
        print(f"no Landlock here ({error.strerror}): the camera's program can read what we can", file=sys.stderr)
    os.execvpe(command[0], command, environment)


if __name__ == "__main__":
    main(sys.argv[1:])
