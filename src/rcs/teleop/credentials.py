"""Credentials for another machine that leads a robot: a certificate made at first use, and a code both sides know."""

from __future__ import annotations

import datetime
import ipaddress
import os
import secrets
import socket
import ssl
from pathlib import Path

from rcs.errors import InvalidSetup
from rcs.extras import package_of

LETTERS = "23456789abcdefghjkmnpqrstuvwxyz"
"""Letters of codes: none that are mistaken for another."""
LENGTH = 8
VALID_FOR = datetime.timedelta(days=3650)


def folder() -> Path:
    """Return the user's folder for both."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config").expanduser() / "rcs"


def code() -> str:
    """Return the code, made at first use; delete its file to have another one.

    Raises:
        InvalidSetup: Its file cannot be read or written.
    """
    path = folder() / "teleop-code"
    if not path.exists():
        _write(path, "".join(secrets.choice(LETTERS) for _ in range(LENGTH)).encode())
    try:
        found = path.read_text("ascii").strip()
    except (OSError, UnicodeError) as err:
        raise InvalidSetup(f"{path} cannot be read ({err}); delete it, and another code is made.") from err
    if len(found) < LENGTH:
        raise InvalidSetup(f"{path} has {len(found)} of {LENGTH} letters; delete it, and another code is made.")
    return found


def tls() -> ssl.SSLContext:
    """Return the settings of a server with the certificate, which is made at first use.

    Raises:
        InvalidSetup: Its file cannot be read or written.
        MissingDependency: The package that makes certificates is not installed.
    """
    path = folder() / "teleop.pem"
    if not path.exists():
        _write(path, _certificate())
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.num_tickets = 0  # a client in Python may read a ticket while it writes, and lose the connection (gh-124984)
    try:
        context.load_cert_chain(path)
    except (OSError, ssl.SSLError) as err:
        raise InvalidSetup(f"{path} is no certificate ({err}); delete it, and another one is made.") from err
    return context


def own_addresses() -> list[str]:
    """Return addresses at which other machines may reach this one, the likeliest first."""
    found: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("10.254.254.254", 1))  # sends nothing; the system chooses the interface
            found.append(probe.getsockname()[0])
        except OSError:
            pass
    try:
        every = socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET, socket.SOCK_STREAM)
        found += [str(entry[4][0]) for entry in every]
    except OSError:
        pass
    return list(dict.fromkeys([*found, "127.0.0.1"]))


def _certificate() -> bytes:
    """Return a new key with a certificate for this machine's names and addresses."""
    x509 = package_of("teleop", "cryptography.x509", "A page for headsets needs")
    oid = package_of("teleop", "cryptography.x509.oid").NameOID
    primitives = package_of("teleop", "cryptography.hazmat.primitives")
    curves = package_of("teleop", "cryptography.hazmat.primitives.asymmetric.ec")
    formats = package_of("teleop", "cryptography.hazmat.primitives.serialization")
    key = curves.generate_private_key(curves.SECP256R1())
    name = x509.Name([x509.NameAttribute(oid.COMMON_NAME, "Robot Control Stack")])
    host = socket.gethostname()
    names = [x509.DNSName(one) for one in dict.fromkeys(("localhost", host, f"{host}.local")) if one.isascii()]
    names += [x509.IPAddress(ipaddress.ip_address(one)) for one in own_addresses()]
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))  # clocks of headsets are off
        .not_valid_after(now + VALID_FOR)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, primitives.hashes.SHA256())
    )
    pem = formats.Encoding.PEM
    private = key.private_bytes(pem, formats.PrivateFormat.PKCS8, formats.NoEncryption())
    return private + certificate.public_bytes(pem)


def _write(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp")
        temporary.unlink(missing_ok=True)
        with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(data)  # nobody else may read it, at no time
        temporary.replace(path)
    except OSError as err:
        raise InvalidSetup(f"{path} cannot be written: {err}. XDG_CONFIG_HOME may name another folder.") from err
