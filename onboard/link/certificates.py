"""Certificates for an encrypted link: a private authority, one certificate an aircraft, one a person on the ground.

The authority's key signs and does nothing else; it never belongs on the aircraft. An aircraft's certificate may be
served and shown; a person's only shown, so that no one on the ground can act as an aircraft.
"""

from __future__ import annotations

import grp
import ipaddress
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from contract.errors import InputError
from contract.fleet import NAME
from contract.link_config import CA_FILE, CERTIFICATE_FILE, KEY_FILE

AUTHORITY = "authority"
SERVICE_GROUP = "pointclick"  # of systemd/pointclick-onboard.service
LOOPBACK = ("localhost", "127.0.0.1", "::1")
# Clocks differ, an aircraft's without a fix most of all.
BACKDATED = timedelta(days=1)


@dataclass(frozen=True)
class Authority:
    """A certificate that both ends trust, and the key that signs for it."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @classmethod
    def create(cls, days: float, now: datetime | None = None) -> Authority:
        """A new one."""
        now = now or datetime.now(UTC)
        key = ec.generate_private_key(ec.SECP256R1())
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "pointclick authority")])
        public = key.public_key()
        certificate = (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(name)
            .public_key(public)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - BACKDATED)
            .not_valid_after(now + timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
            .sign(key, hashes.SHA256())
        )
        return cls(certificate, key)

    @classmethod
    def load(cls, folder: Path) -> Authority:
        """Return the authority of a folder. Raises InputError."""
        try:
            certificate = x509.load_pem_x509_certificate((folder / CA_FILE).read_bytes())
            key = serialization.load_pem_private_key((folder / KEY_FILE).read_bytes(), None)
        except OSError as error:
            raise InputError(f"authority {error.filename}: {error.strerror}") from error
        except ValueError as error:
            raise InputError(f"authority {folder}: {error}") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey) or certificate.public_key() != key.public_key():
            raise InputError(f"authority {folder}: key and certificate do not belong together")
        return cls(certificate, key)

    def save(self, folder: Path) -> None:
        """Into its folder. Raises InputError."""
        _write(folder, {CA_FILE: _pem(self.certificate), KEY_FILE: _pem_key(self.key)})

    def issue(
        self,
        name: str,
        folder: Path,
        *,
        days: float,
        addresses: Sequence[str] = (),
        serves: bool = False,
        now: datetime | None = None,
        group: int | None = None,
    ) -> None:
        """Write the folder of an aircraft or a person: `ca.pem`, `certificate.pem`, `key.pem`. Raises InputError.

        `name` becomes the common name; `addresses` are where one that `serves` is reached, IP addresses or host names;
        `group` may read the files, as may their owner.
        """
        if not NAME.fullmatch(name):
            raise InputError(f"name {name!r} must be 1 to 32 letters, digits, '_', '.' or '-'")
        now = now or datetime.now(UTC)
        end = min(now + timedelta(days=days), self.certificate.not_valid_after_utc)
        key = ec.generate_private_key(ec.SECP256R1())
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH] + [ExtendedKeyUsageOID.SERVER_AUTH] * serves
        names = dict.fromkeys((name, *addresses, *LOOPBACK) if serves else (name,))
        issuer = self.certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier).value
        certificate = (
            x509.CertificateBuilder()
            .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]))
            .issuer_name(self.certificate.subject)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(min(now - BACKDATED, end - timedelta(seconds=1)))
            .not_valid_after(end)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
            .add_extension(x509.SubjectAlternativeName([_alternative(n) for n in names]), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(issuer), critical=False)
            .sign(self.key, hashes.SHA256())
        )
        files = {CA_FILE: _pem(self.certificate), CERTIFICATE_FILE: _pem(certificate), KEY_FILE: _pem_key(key)}
        _write(folder, files, group)


def make_credentials(
    folder: Path,
    vehicles: Sequence[str],
    people: Sequence[str],
    addresses: Sequence[str],
    days: float,
    routers: Sequence[str] = (),
) -> list[Path]:
    """One folder for each of them under `folder`, signed by the authority there or a new one; returns those folders.

    `addresses` are where the routers are reached or, without any, the aircraft: none of these may pass for a router.
    Raises InputError if a name is given twice, is no name, or has a folder already: a certificate in use is not
    replaced by a slip of the pen.
    """
    everyone = [*routers, *vehicles, *people]
    for name in everyone:
        if everyone.count(name) > 1 or name == AUTHORITY:
            raise InputError(f"name {name!r} can stand for one certificate only")
        if not NAME.fullmatch(name):
            raise InputError(f"name {name!r} must be 1 to 32 letters, digits, '_', '.' or '-'")
        if (folder / name).exists():
            raise InputError(f"{folder / name} exists: remove it to issue {name!r} a new certificate")
    for address in addresses:
        _alternative(address)
    if (folder / AUTHORITY).exists():
        authority = Authority.load(folder / AUTHORITY)
    else:
        authority = Authority.create(days=max(days, 3650.0))
        authority.save(folder / AUTHORITY)
    for name in everyone:
        serves = name in vehicles or name in routers
        reached = addresses if name in (routers or vehicles) else ()
        group = service_group() if name in vehicles else None
        authority.issue(name, folder / name, days=days, addresses=reached, serves=serves, group=group)
    return [folder / name for name in everyone]


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _alternative(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        pass
    if not re.fullmatch(r"[A-Za-z0-9_]([A-Za-z0-9_.-]{0,251}[A-Za-z0-9_])?", name):
        raise InputError(f"address {name!r} is neither an IP address nor a host name")
    return x509.DNSName(name)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _pem_key(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def service_group() -> int | None:
    """The group of the aircraft's service, if this is its computer and root asks: as it may give files to it."""
    try:
        return grp.getgrnam(SERVICE_GROUP).gr_gid if os.geteuid() == 0 else None
    except KeyError:
        return None


def _write(folder: Path, files: dict[str, bytes], group: int | None = None) -> None:
    """New files that only their owner, and a group if it is given, can read, from the moment they exist."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for name, content in files.items():
            descriptor = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "wb") as stream:
                if group is not None:
                    os.fchown(descriptor, -1, group)
                    os.fchmod(descriptor, 0o640)
                stream.write(content)
        if group is not None:
            os.chown(folder, -1, group)
            folder.chmod(0o750)
    except OSError as error:
        raise InputError(f"{error.filename}: {error.strerror}") from error
