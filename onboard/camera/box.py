"""A box around a program that reads what strangers send: it cannot open the files that are closed to it, nor the
network where it needs none.

A program of its own, run as a script by the system's Python before the one that is named after `--`:

    python3 -I box.py [--no-network] CLOSED... -- COMMAND...

Nothing of this project is imported. By Landlock, which needs no privilege and holds for all that the command starts: it
may read and write what its user may, but for the closed files and folders, and not the memory of processes outside; of
the environment it gets what KEPT names. With `--no-network`, by seccomp, it makes no sockets but local ones (AF_UNIX)
and the kernel's own (AF_NETLINK); without, its pictures come from the network. A kernel without Landlock (before 5.13)
or seccomp is reported on the error stream, and the command runs without.
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
NO_NETWORK = "--no-network"
PR_SET_SECCOMP, MODE_FILTER = 22, 2
# Each machine has a number for seccomp (AUDIT_ARCH_...) and one of its call for sockets.
MACHINES = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}
IO_URING_SETUP = 425  # by which sockets are made without that call
OTHER_NUMBERING = 0x40000000  # x32's calls on x86-64
AF_UNIX, AF_NETLINK = 1, 16  # libcamera and udev listen to the latter for devices
AT_CALL, AT_MACHINE, AT_FIRST_ARGUMENT = 0, 4, 16  # in struct seccomp_data
LOAD, IF_EQUAL, IF_AT_LEAST, RETURN = 0x20, 0x15, 0x35, 0x06  # of classic BPF, on 32 bits
ALLOW, REFUSE = 0x7FFF0000, 0x00050000 | 13  # EACCES


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


def _filter(machine: str) -> bytes:
    """Return the rules for system calls, in classic BPF. Raises OSError for a machine that is not known."""
    if machine not in MACHINES:
        raise OSError(38, f"no rules for {machine}")
    number, socket_call = MACHINES[machine]
    rules = (  # what to do, by how many to skip if it is so and if not, with what
        (LOAD, 0, 0, AT_MACHINE),
        (IF_EQUAL, 0, 8, number),  # 32 bit programs have calls of other numbers
        (LOAD, 0, 0, AT_CALL),
        (IF_AT_LEAST, 6, 0, OTHER_NUMBERING),
        (IF_EQUAL, 5, 0, IO_URING_SETUP),
        (IF_EQUAL, 0, 3, socket_call),
        (LOAD, 0, 0, AT_FIRST_ARGUMENT),
        (IF_EQUAL, 1, 0, AF_UNIX),
        (IF_EQUAL, 0, 1, AF_NETLINK),
        (RETURN, 0, 0, ALLOW),
        (RETURN, 0, 0, REFUSE),
    )
    return b"".join(struct.pack("=HBBI", *rule) for rule in rules)


def leave_network() -> None:
    """Make no sockets to other computers or programs on them from now on, nor let a command do so. Raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    rules = _filter(os.uname().machine)
    held = ctypes.create_string_buffer(rules)
    program = ctypes.create_string_buffer(struct.pack("@HP", len(rules) // 8, ctypes.addressof(held)))
    if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 or libc.prctl(PR_SET_SECCOMP, MODE_FILTER, program, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def main(arguments: list[str]) -> None:
    """Enter the box and become the command."""
    at = arguments.index("--")
    closed, command = set(arguments[:at]), arguments[at + 1 :]
    is_offline = NO_NETWORK in closed
    closed.discard(NO_NETWORK)
    environment = {key: value for key, value in os.environ.items() if key.startswith(KEPT)}
    try:
        enter(closed)
    except OSError as error:
        print(f"no Landlock here ({error.strerror}): the camera's program can read what we can", file=sys.stderr)
    if is_offline:
        try:
            leave_network()
        except OSError as error:
            print(f"no seccomp here ({error.strerror}): the network is open to the camera's program", file=sys.stderr)
    os.execvpe(command[0], command, environment)


if __name__ == "__main__":
    main(sys.argv[1:])
