"""`pc-onboard make-credentials`: issues certificates for an encrypted link, and notes who may do what."""

from __future__ import annotations

import argparse
from dataclasses import replace

from contract.errors import InputError
from contract.fleet import FLEET_FILE, Fleet, read_fleet
from contract.whole_file import save
from onboard.link.certificates import AUTHORITY, make_credentials


def run(arguments: argparse.Namespace) -> int:
    """Issue certificates and print where they are. Raises InputError."""
    vehicles, people = arguments.vehicle, [*arguments.operator, *arguments.viewer]
    routers = [] if arguments.router is None else [arguments.router]
    if not vehicles and not people and not routers:
        raise InputError("whom for? name at least one --vehicle, --operator, --viewer or --router")
    place = arguments.folder / FLEET_FILE
    listed = read_fleet(place) if place.exists() else Fleet()
    operators = tuple(arguments.operator)
    listed = replace(listed, router=arguments.router or listed.router).with_more(
        aircraft=tuple(vehicles), operators=operators, viewers=tuple(arguments.viewer), pins=operators
    )
    for folder in make_credentials(
        arguments.folder, vehicles, people, arguments.address, arguments.days, routers=routers
    ):
        print(folder)
    save(place, listed.to_toml())
    print(f"{arguments.folder / AUTHORITY} (signs new ones: keep it off the aircraft and away from others)")
    print(f"{place} (who may do what: for pc-ground router --config)")
    return 0
