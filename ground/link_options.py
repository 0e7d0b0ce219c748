"""The options of a link to aircraft, the same for every command that has one."""

from __future__ import annotations

import argparse
from pathlib import Path

from contract.errors import PointclickError
from contract.link_config import CA_FILE, CERTIFICATE_FILE, KEY_FILE, Tls
from contract.topics import DEFAULT_ENDPOINT


class UsageError(PointclickError):
    """Arguments that do not go together."""


def add_tls_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of an encrypted link."""
    parser.add_argument(
        "--credentials",
        metavar="DIR",
        type=Path,
        help=f"folder with {CA_FILE}, {CERTIFICATE_FILE} and {KEY_FILE}, from pc-onboard make-credentials",
    )
    for name, meaning in (("ca", "the authority's certificate"), ("certificate", "ours"), ("key", "its private key")):
        parser.add_argument(f"--{name}", metavar="FILE.pem", type=Path, help=f"{meaning}, in place of --credentials")


def tls_of(args: argparse.Namespace) -> Tls | None:
    """The certificates that are to be shown; None for a plain link. Raises PointclickError."""
    if args.credentials is None:
        return Tls.of(args.ca, args.certificate, args.key)
    if args.ca or args.certificate or args.key:
        raise UsageError("--credentials names the folder of all three files: leave --ca, --certificate and --key out")
    return Tls.in_folder(args.credentials)


def endpoint_of(args: argparse.Namespace, tls: Tls | None) -> str:
    """The endpoint to connect to: `--connect`, or the default, encrypted if there are certificates."""
    if args.connect:
        return str(args.connect)
    return DEFAULT_ENDPOINT if tls is None else DEFAULT_ENDPOINT.replace("tcp/", "tls/", 1)
