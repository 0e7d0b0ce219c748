"""A ground station's router: zenoh's own, with certificates and rights by their names. No aircraft, no display.

The rights are zenoh's access control, fixed when a session opens: a changed list is a new session, which everybody
finds again by himself within seconds.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import zenoh

from contract.closing import Closing
from contract.errors import LinkError
from contract.fleet import Fleet
from contract.link_config import EVERY_MESSAGE, GROUND_REGION, Tls, link_config
from contract.topics import ANY_VEHICLE, FEATURES, PINS, of_vehicle

EVERY_AIRCRAFT = of_vehicle(ANY_VEHICLE)
EVERY_PIN = f"{PINS}/*/*"
# Between regions everything is relayed, and within one nothing: aircraft never receive from each other.
REGIONS: list[dict[str, list[str]]] = [
    {"modes": ["client"]},
    {"modes": ["peer"], "region_names": [GROUND_REGION]},
    {"modes": ["peer"]},
]


def router_config(fleet: Fleet, folder: Path) -> dict[str, Any]:
    """The configuration of a zenoh router, for this program and for `zenohd`.

    `folder` holds the router's certificate under its name. Raises LinkError if it is missing, or for a plain endpoint.
    """
    own = (folder / fleet.router).absolute()
    if not own.is_dir():
        raise LinkError(f"no certificate {own}: pc-onboard make-credentials {folder} --router {fleet.router}")
    tls = Tls.in_folder(own)
    config: dict[str, Any] = json.loads(link_config("router", listen=fleet.listen, connect=fleet.connect, tls=tls))
    # No one learns where others listen: all traffic goes through here, where the rights are.
    config["scouting"]["gossip"] = {"enabled": False}
    config["gateway"] = {"south": [{"filters": [region]} for region in REGIONS]}
    config["access_control"] = _rights(fleet)
    if fleet.sets_hz > 0.0:
        config["downsampling"] = [_thinned(fleet)]
    return config


def _rights(fleet: Fleet) -> dict[str, Any]:
    """Rules by role. What no rule allows is refused, also to a name that the authority has signed and no list has."""
    rules = [
        _rule("read", "ingress", ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")),
        _rule("be sent", "egress", ("put", "liveliness_token")),
        _rule("ask", "ingress", ("query",)),
        _rule("be answered", "egress", ("reply", "declare_queryable")),
        _rule(
            "be asked",
            "egress",
            ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"),
        ),
        {
            "id": "share pins",
            "permission": "allow",
            "messages": ["put", "declare_subscriber", "query", "reply", "declare_queryable"],
            "flows": ["ingress", "egress"],
            "key_exprs": [EVERY_PIN],
        },
    ]
    rules.append(
        {**rules[-1], "id": "relay", "messages": list(EVERY_MESSAGE), "key_exprs": [EVERY_AIRCRAFT, EVERY_PIN]}
    )
    subjects: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []

    def may(who: str, names: tuple[str, ...], what: list[str]) -> None:
        if names:  # a subject without names would be everybody
            subjects.append({"id": who, "cert_common_names": list(names)})
            policies.append({"subjects": [who], "rules": what})

    for name in fleet.aircraft:
        own = f"publish as {name}"
        rules.append(_rule(own, "ingress", ("put", "reply", "declare_queryable", "liveliness_token"), of_vehicle(name)))
        may(f"aircraft {name}", (name,), [own, "be asked"])
    may("operators", fleet.operators, ["read", "be sent", "ask", "be answered"])
    may("viewers", fleet.viewers, ["read", "be sent"])
    may("stations", fleet.stations, ["relay"])
    may("pins", fleet.pins, ["share pins"])
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(name: str, flow: str, messages: tuple[str, ...], key: str = EVERY_AIRCRAFT) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": [key]}


def _thinned(fleet: Fleet) -> dict[str, Any]:
    """Zenoh counts by rule, not by key: a rule for each aircraft, or they would share one rate."""
    return {
        "id": "sets",
        "flows": ["egress"],
        "messages": ["put"],
        "rules": [{"key_expr": FEATURES.key(name), "freq": fleet.sets_hz} for name in fleet.aircraft],
    }


class Router(Closing):
    """A router that runs until it is closed. Raises LinkError if it cannot: the reason names port or file."""

    def __init__(self, fleet: Fleet, folder: Path) -> None:
        self.fleet = fleet
        self._folder = folder
        self._session = _opened(fleet, router_config(fleet, folder))

    def replace(self, fleet: Fleet) -> None:
        """Go on with another list. Raises LinkError if that cannot be; then the old one stays.

        Everybody is hung up on, and connects again within a second or two.
        """
        old, new = router_config(self.fleet, self._folder), router_config(fleet, self._folder)
        self._session.close()
        try:
            self._session = _opened(fleet, new)
        except LinkError:
            self._session = _opened(self.fleet, old)
            raise
        self.fleet = fleet

    def close(self) -> None:
        self._session.close()


def _opened(fleet: Fleet, config: dict[str, Any]) -> Any:
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    except zenoh.ZError as error:
        reason = str(error).split(" at ", maxsplit=1)[0]
        raise LinkError(f"the router cannot listen at {', '.join(fleet.listen)}: {reason}") from error
