"""A TAK server of others for the tests: taky from PyPI, in an environment of its own, with our certificates."""

import contextlib
import socket
import ssl
import subprocess
import sys
import threading
import xml.etree.ElementTree as ET
from pathlib import Path

from tests.onboard.link.ports import free_port
from tests.waiting import PATIENCE_S, eventually

# What it imports to route events; lxml, cryptography and dateutil are this environment's. MIT, all but redis too.
PACKAGES = ("taky==0.10", "redis==8.1.0", "setuptools==80.9.0")
CONFIG = """\
[taky]
hostname = 127.0.0.1
bind_ip = 127.0.0.1
root_dir = .
[cot_server]
port = {port}
[dp_server]
upload_path = packages
[ssl]
enabled = true
client_cert_required = true
ca = {server}/ca.pem
cert = {server}/certificate.pem
key = {server}/key.pem
cert_db = certificates.txt
"""


def installed(folder: Path) -> Path | None:
    """Its Python, in a new environment; None where PyPI cannot be reached."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True, timeout=PATIENCE_S)
    (packages,) = (folder / "lib").glob("python3*/site-packages")
    (ours,) = {path for path in map(Path, sys.path) if (path / "lxml").is_dir()}
    (packages / "ours.pth").write_text(f"{ours}\n")
    done = subprocess.run(
        [sys.executable, "-m", "pip", "--python", folder / "bin" / "python", "install", "--no-deps", "--quiet",
         "--disable-pip-version-check", "--retries", "1", *PACKAGES],
        capture_output=True, text=True, check=False, timeout=4 * PATIENCE_S,
    )  # fmt: skip
    return folder / "bin" / "python" if done.returncode == 0 else None


class Taky:
    """The server; it can be killed, and started again at its port."""

    def __init__(self, python: Path, folder: Path, keys: Path) -> None:
        self._python, self._folder = python, folder
        self.port = free_port()
        (folder / "taky.conf").write_text(CONFIG.format(port=self.port, server=keys / "server"))

    def start(self) -> None:
        """Until it takes connections."""
        with (self._folder / "log").open("a") as log:
            self._process = subprocess.Popen(
                [self._python, "-m", "taky.cot", "-c", "taky.conf"], cwd=self._folder, stdout=log, stderr=log
            )
        assert eventually(self._listens), (self._folder / "log").read_text()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait(PATIENCE_S)

    def _listens(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port)).close()
        except OSError:
            return False
        return True


class Watcher:
    """A client that sends nothing, and connects again when its stream ends."""

    def __init__(self, port: int, keys: Path) -> None:
        self._port = port
        self._context = ssl.create_default_context(cafile=keys / "watcher" / "ca.pem")
        self._context.load_cert_chain(keys / "watcher" / "certificate.pem", keys / "watcher" / "key.pem")
        self._going = threading.Event()
        self.events: list[ET.Element] = []
        self.streams = 0
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def close(self) -> None:
        self._going.set()
        self._thread.join(PATIENCE_S)

    def _watch(self) -> None:
        while not self._going.wait(0.02):
            with contextlib.suppress(OSError):
                plain = socket.create_connection(("127.0.0.1", self._port))
                with self._context.wrap_socket(plain, server_hostname="127.0.0.1") as stream:
                    self._read(stream)

    def _read(self, stream: ssl.SSLSocket) -> None:
        """Each event as it is whole: they follow each other as one document that never ends."""
        parser = ET.XMLPullParser(["end"])
        parser.feed(b"<events>")
        stream.settimeout(0.1)
        self.streams += 1
        while not self._going.is_set():
            try:
                part = stream.recv(65536)
            except TimeoutError:
                continue
            if not part:
                return
            parser.feed(part)
            for item in parser.read_events():
                if isinstance(item[1], ET.Element) and item[1].tag == "event":
                    self.events.append(item[1])
