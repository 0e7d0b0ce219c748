"""A PostgreSQL server of the tests' own: Debian's programs, a folder of its own, a socket there and no port.

`python -m tests.postgres` succeeds where there is one; `make test` installs PACKAGES where it may.
"""

import contextlib
import os
import pwd
import shutil
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from tests.waiting import PATIENCE_S

PACKAGES = "postgresql"
USER = "postgres"  # of the system, whom root starts the server as: it refuses to run as root


def programs() -> Path | None:
    """The folder of initdb and postgres, the newest there is; None without one."""
    folders = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda folder: float(folder.parent.name))
    found = [folder for folder in folders if (folder / "initdb").is_file() and (folder / "postgres").is_file()]
    return found[-1] if found else None


class Server:
    """A running server. Databases are made one after the other, each by a name of its own."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self._folder, self._programs = folder, programs
        self._as: list[str] = []
        if os.geteuid() == 0:
            user = pwd.getpwnam(USER)
            os.chown(folder, user.pw_uid, user.pw_gid)
            self._as = ["setpriv", f"--reuid={USER}", f"--regid={user.pw_gid}", "--clear-groups"]
        self._run("initdb", "-D", str(folder / "data"), "-U", "pins", "-A", "trust", "-E", "UTF8", "--no-sync")
        self.start()

    def start(self) -> None:
        """Until it answers."""
        self._process = subprocess.Popen(
            [*self._as, self._programs / "postgres", "-D", self._folder / "data", "-k", self._folder,
             "-c", "listen_addresses=", "-c", "fsync=off"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=self._folder,
        )  # fmt: skip
        until_s = time.monotonic() + PATIENCE_S
        while subprocess.run([self._programs / "pg_isready", "-q", "-h", self._folder], check=False).returncode != 0:
            assert self._process.poll() is None and time.monotonic() < until_s
            time.sleep(0.05)

    def stop(self) -> None:
        """At once: clients are hung up on."""
        self._process.send_signal(2)
        self._process.wait(PATIENCE_S)

    def database(self) -> str:
        """A new one's URL."""
        name = f"pins_{uuid.uuid4().hex}"
        self._run("createdb", "-h", str(self._folder), "-U", "pins", name)
        return f"postgresql://pins:secret-word@/{name}?host={self._folder}"

    def _run(self, program: str, *arguments: str) -> None:
        command = [*self._as, str(self._programs / program), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=self._folder, timeout=60)
        assert done.returncode == 0, done.stderr


@contextlib.contextmanager
def running() -> Iterator[Server]:
    """A server, until the end of the block."""
    found = programs()
    assert found is not None
    folder = Path(tempfile.mkdtemp(prefix="pins-"))  # short: the path of a socket may have 107 bytes
    try:
        server = Server(folder, found)
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(programs() is None)
