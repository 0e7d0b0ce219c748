"""A server of Cursor on Target with certificates on both sides, that goes and comes back; and what is sent to it."""

import contextlib
import socket
import ssl
import threading
import xml.etree.ElementTree as ET
from pathlib import Path

from ground.formats.imported import entered_pin
from ground.pins.store import PinStore
from onboard.link.certificates import make_credentials
from tests.onboard.link.ports import free_port
from tests.waiting import PATIENCE_S, eventually

LAT_STEP_DEG = 1e-3
LON_DEG = 2.0


def issue(folder: Path) -> Path:
    """The certificates of a server and two clients, by one authority, and of one client by another; their folder."""
    make_credentials(folder, ["server"], ["ground", "watcher"], ["127.0.0.1"], 10.0)
    make_credentials(folder / "elsewhere", [], ["stranger"], [], 10.0)
    return folder


def to(keys: Path, port: int, certificate: Path | None = None) -> list[str]:
    ours = keys / "ground"
    shown = certificate or ours
    return [
        "cot", "--only-pins", "--to", f"tls://127.0.0.1:{port}", "--to-ca", str(ours / "ca.pem"),
        "--to-certificate", str(shown / "certificate.pem"), "--to-key", str(shown / "key.pem"),
    ]  # fmt: skip


def add_pins(store: PinStore, numbers: range) -> None:
    """Pins of these numbers, as others make them while the command runs; each has a latitude of its own."""
    store.bring_in(
        [
            entered_pin(lat_deg=number * LAT_STEP_DEG, lon_deg=LON_DEG, sigma_m=2.0, name=f"p{number}")
            for number in numbers
        ]
    )


def number_of(event: ET.Element) -> int:
    """The pin that an event shows, by its name; its place is that pin's."""
    contact, point = event.find("detail/contact"), event.find("point")
    assert contact is not None and point is not None
    number = int(contact.get("callsign", "").rpartition("p")[2])
    assert abs(float(point.get("lat", "")) - number * LAT_STEP_DEG) < 1e-6
    assert abs(float(point.get("lon", "")) - LON_DEG) < 1e-6
    return number


class Server:
    """Reads events, and sends events of others all the time, as a server does that others use too."""

    def __init__(self, keys: Path) -> None:
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.load_cert_chain(keys / "server" / "certificate.pem", keys / "server" / "key.pem")
        self._context.load_verify_locations(keys / "server" / "ca.pem")
        self._context.verify_mode = ssl.CERT_REQUIRED
        self.port = free_port()
        self._received: list[bytearray] = []  # of each connection
        self._going = threading.Event()
        self._listener: socket.socket | None = None

    def start(self) -> None:
        self._going.clear()
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self._thread = threading.Thread(target=self._serve, args=[self._listener])
        self._thread.start()

    def stop(self) -> None:
        if self._listener is None:
            return
        self._going.set()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join(PATIENCE_S)
        self._listener.close()
        self._listener = None

    @property
    def events(self) -> list[ET.Element]:
        return [ET.fromstring(text + b"</event>") for one in self._received for text in one.split(b"</event>")[:-1]]

    def has(self, count: int) -> bool:
        return eventually(lambda: sum(one.count(b"</event>") for one in self._received) >= count)

    def _serve(self, listener: socket.socket) -> None:
        while True:
            try:
                plain, _ = listener.accept()
            except OSError:
                return
            with contextlib.suppress(OSError), self._context.wrap_socket(plain, server_side=True) as client:
                self._received.append(bytearray())
                client.settimeout(0.01)
                while not self._going.is_set():
                    client.sendall(b"<event uid='of others'/>")
                    with contextlib.suppress(TimeoutError):
                        part = client.recv(65536)
                        if not part:
                            break
                        self._received[-1] += part
            plain.close()
