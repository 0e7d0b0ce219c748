"""The zenoh configuration of both ends, as JSON text. Values measured on cut, lossy and thin links (docs/link.md)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from contract.callback_threads import awaited_at_exit
from contract.errors import LinkError
from contract.look import look_key
from contract.topics import ANY_VEHICLE, FOLLOW, TOPICS

OPEN_TIMEOUT_MS = 2000
# Far above all that we send: a larger message is dropped, and does not fill our memory.
MAX_MESSAGE_BYTES = 2_000_000
SECURE = ("tls/", "quic/")
# Peers of one region are not relayed to each other by a router: grounds are of another than aircraft.
GROUND_REGION = "ground"
CA_FILE, CERTIFICATE_FILE, KEY_FILE = "ca.pem", "certificate.pem", "key.pem"


@dataclass(frozen=True)
class Tls:
    """Files (PEM) of one end: the authority that both accept, its own certificate and its private key."""

    ca: str
    certificate: str
    key: str

    @classmethod
    def of(cls, ca: Path | str | None, certificate: Path | str | None, key: Path | str | None) -> Tls | None:
        """The three, or None if none is given. Raises LinkError if some are missing or cannot be read."""
        given = {"ca": ca, "certificate": certificate, "key": key}
        missing = [name for name, path in given.items() if path is None]
        if len(missing) == len(given):
            return None
        if missing:
            raise LinkError(f"TLS needs ca, certificate and key together; {' and '.join(missing)} is missing")
        for name, path in given.items():
            try:
                Path(str(path)).read_bytes()
            except OSError as error:
                raise LinkError(f"TLS {name} {path}: {error.strerror}") from error
        return cls(str(ca), str(certificate), str(key))

    @classmethod
    def in_folder(cls, folder: Path | str) -> Tls:
        """The three files of a folder as `pc-onboard make-credentials` writes it. Raises LinkError."""
        place = Path(folder)
        found = cls.of(place / CA_FILE, place / CERTIFICATE_FILE, place / KEY_FILE)
        assert found is not None
        return found


@dataclass(frozen=True)
class Rights:
    """Common names of the certificates that an aircraft lets do more, or anything.

    Of others it takes subscriptions and queries and nothing else: of those in `allowed`, if any are named. Of these,
    only the `trackers` may begin and end tracks, if any are named. Only the `pointers` may have the camera look
    somewhere, each in its own name: where none are named no one may.
    """

    allowed: Sequence[str] = ()
    trackers: Sequence[str] = ()
    pointers: Sequence[str] = ()


NO_RIGHTS = Rights()


def link_config(
    mode: str,
    *,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    scouting: bool = False,
    tls: Tls | None = None,
    is_aircraft: bool = False,
    rights: Rights = NO_RIGHTS,
) -> str:
    """Text for `zenoh.Config.from_json5`.

    A "peer" goes on without those it connects to and tries them again every 0.5 to 1 s, without end; a "client" tries
    once and fails at once. With `tls` both ends must show a certificate of its authority, and no other kind of endpoint
    is taken: LinkError. Others have `rights` at an aircraft by their certificates: without `tls` no one has
    a name, all may listen, ask and have things followed, and no one may have the camera look somewhere.
    """
    awaited_at_exit()  # what has a session has callbacks
    is_client = mode == "client"
    # What the system buffers while a link is cut is delay when it is back: a small buffer, and small batches.
    streams: dict[str, Any] = {"so_sndbuf": 8192} if is_aircraft else {}
    link: dict[str, Any] = {
        # Ten keep-alives in a lease of ten seconds: reconnects within 2.5 s of a cut, and holds at 20 % loss.
        "tx": {"lease": 10000, "keep_alive": 10, "batch_size": 4096},
        "rx": {"max_message_size": MAX_MESSAGE_BYTES},
    }
    if streams:
        link["tcp"] = streams
    if tls is not None:
        plain = [e for e in (*listen, *connect) if not e.startswith(SECURE)]
        if plain:
            raise LinkError(f"{plain[0]} is not encrypted, and certificates are set: write tls/... or quic/...")
        link["protocols"] = ["tls", "quic"]
        link["tls"] = streams | {
            "root_ca_certificate": tls.ca,
            "enable_mtls": True,
            "listen_certificate": tls.certificate,
            "listen_private_key": tls.key,
            "connect_certificate": tls.certificate,
            "connect_private_key": tls.key,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
    config: dict[str, Any] = {
        "mode": mode,
        "listen": {"endpoints": list(listen)},
        "connect": {
            "endpoints": list(connect),
            "timeout_ms": 0 if is_client else -1,
            "exit_on_failure": is_client,
            "retry": {"period_init_ms": 500, "period_max_ms": 1000, "period_increase_factor": 1},
        },
        "scouting": {"multicast": {"enabled": scouting}},
        "transport": {"unicast": {"open_timeout": OPEN_TIMEOUT_MS}, "link": link},
    }
    if mode == "peer" and not is_aircraft:
        config["region_name"] = GROUND_REGION
    if is_aircraft:
        config["access_control"] = _access(rights if tls is not None else NO_RIGHTS)
    return json.dumps(config)


EVERY_MESSAGE = (
    "put",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


def passing_only(key: str) -> dict[str, Any]:
    """Zenoh's access control of a session that lets nothing pass but one key expression's, to and from anybody."""
    rule = {
        "id": "pass",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": list(EVERY_MESSAGE),
        "key_exprs": [key],
    }
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule],
        "subjects": [{"id": "all"}],
        "policies": [{"rules": ["pass"], "subjects": ["all"]}],
    }


def _access(rights: Rights) -> dict[str, Any]:
    """Others may subscribe and query, and nothing else: no sample, reply or queryable of theirs is let through.

    What may be queried is listed key by key: `pc/**` would reach the queryables of rights that have to be given.
    """
    everything, follow = ["pc/**"], [FOLLOW.key(ANY_VEHICLE)]
    asked = [topic.key(ANY_VEHICLE) for topic in TOPICS] + ([] if rights.trackers else follow)

    def rule(name: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
        return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}

    rules = [
        rule(
            "subscribe",
            "ingress",
            ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"),
            everything,
        ),
        rule("query", "ingress", ("query",), asked),
        rule("receive", "egress", ("put", "reply", "declare_queryable", "liveliness_token"), everything),
    ]
    policies = [{"rules": [rule["id"] for rule in rules], "subjects": ["grounds"]}]
    grounds: dict[str, Any] = {"id": "grounds"}
    if rights.allowed:
        grounds["cert_common_names"] = list(rights.allowed)
    subjects = [grounds]
    if rights.trackers:
        rules.append(rule("follow", "ingress", ("query",), follow))
        subjects.append({"id": "trackers", "cert_common_names": list(rights.trackers)})
        policies.append({"rules": ["follow"], "subjects": ["trackers"]})
    for name in rights.pointers:
        rules.append(rule(f"look as {name}", "ingress", ("query",), [look_key(ANY_VEHICLE, name)]))
        subjects.append({"id": f"pointer {name}", "cert_common_names": [name]})
        policies.append({"rules": [f"look as {name}"], "subjects": [f"pointer {name}"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }
