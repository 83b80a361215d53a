"""TLS and passwords, with a real broker: the right ones work, each wrong one is one clear line."""

import base64
import datetime
import hashlib
import ipaddress
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import mqtt_fixtures
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from mqtt_daemon import FakeDaemon
from mqtt_mosquitto import Mosquitto, Subscriber
from mqtt_process import Process, write_config
from ports import free_port

daemon, broker = mqtt_fixtures.daemon, mqtt_fixtures.broker

Key = ec.EllipticCurvePrivateKey
LONG_AGO, LONG_HENCE = datetime.datetime(2020, 1, 1), datetime.datetime(2090, 1, 1)


def name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


class Authority:
    """A certificate authority that a test makes."""

    def __init__(self, folder: Path, common: str) -> None:
        self._folder, self._name, self._key = folder, name(common), ec.generate_private_key(ec.SECP256R1())
        self.path = folder / f"{common}.pem"
        usage = x509.KeyUsage(False, False, False, False, False, True, True, False, False)
        made = self._builder(self._name, self._key, LONG_HENCE)
        made = made.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        made = made.add_extension(usage, critical=True)
        self.path.write_bytes(made.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))

    def sign(self, file: str, *hosts: str, until: datetime.datetime = LONG_HENCE) -> tuple[str, str]:
        """Paths of a certificate for these hosts, and of its key."""
        key = ec.generate_private_key(ec.SECP256R1())
        names: list[x509.GeneralName] = [
            x509.IPAddress(ipaddress.ip_address(host)) if host[0].isdigit() else x509.DNSName(host) for host in hosts
        ]
        made = self._builder(name(file), key, until).add_extension(x509.SubjectAlternativeName(names), critical=False)
        issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())
        made = made.add_extension(issuer, critical=False)
        paths = self._folder / f"{file}.crt", self._folder / f"{file}.key"
        paths[0].write_bytes(made.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
        paths[1].write_bytes(pem(key))
        return str(paths[0]), str(paths[1])

    def _builder(self, subject: x509.Name, key: Key, until: datetime.datetime) -> x509.CertificateBuilder:
        made = x509.CertificateBuilder().subject_name(subject).issuer_name(self._name).public_key(key.public_key())
        made = made.serial_number(x509.random_serial_number()).not_valid_before(LONG_AGO).not_valid_after(until)
        return made.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)


def pem(key: Key, password: bytes | None = None) -> bytes:
    encryption: serialization.KeySerializationEncryption = serialization.NoEncryption()
    if password is not None:
        encryption = serialization.BestAvailableEncryption(password)
    return key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)


class Secured:
    """A broker that asks for TLS on one port and for nothing, from the backend, on another."""

    def __init__(self, folder: Path, certificate: tuple[str, str], *lines: str) -> None:
        self.port = free_port()
        tls = [f"listener {self.port} 127.0.0.1", f"certfile {certificate[0]}", f"keyfile {certificate[1]}"]
        self._broker = Mosquitto(folder, *tls, *(lines or ["allow_anonymous true"]))
        self._broker.start()
        self.backend = Subscriber(self._broker.port)

    def close(self) -> None:
        self.backend.close()
        self._broker.stop()


Secure = Callable[..., Secured]


@pytest.fixture
def secure(tmp_path: Path) -> Iterator[Secure]:
    """Begins a broker with that certificate and these lines of configuration."""
    with ExitStack() as begun:

        def begin(certificate: tuple[str, str], *lines: str) -> Secured:
            secured = Secured(tmp_path, certificate, *lines)
            begun.callback(secured.close)
            return secured

        yield begin


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path, "ca")


def test_a_broker_with_the_right_certificate_is_believed(
    tmp_path: Path, daemon: FakeDaemon, secure: Secure, authority: Authority
) -> None:
    """A storm, as TLS keeps bytes back that no selector shows."""
    secured = secure(authority.sign("broker", "localhost"))
    told = daemon.storm(500)
    process = Process(write_config(tmp_path, secured.port, tls=(f'ca = "{authority.path}"',)))
    secured.backend.wait(lambda: len(secured.backend.ids()) == 500)
    assert process.stop() == 0
    assert secured.backend.ids() == told
    secured.backend.wait_status("offline")


def wrong_authority(folder: Path, authority: Authority) -> tuple[tuple[str, str], str]:
    return authority.sign("broker", "localhost"), str(Authority(folder, "other").path)


def wrong_name(folder: Path, authority: Authority) -> tuple[tuple[str, str], str]:
    return authority.sign("broker", "broker.example", "127.0.0.1"), str(authority.path)


def wrong_time(folder: Path, authority: Authority) -> tuple[tuple[str, str], str]:
    return authority.sign("broker", "localhost", until=datetime.datetime(2021, 1, 1)), str(authority.path)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (wrong_authority, "unable to get local issuer certificate"),
        (wrong_name, "Hostname mismatch, certificate is not valid for 'localhost'"),
        (wrong_time, "certificate has expired"),
    ],
)
def test_a_broker_with_a_wrong_certificate_is_not_talked_to(
    tmp_path: Path,
    daemon: FakeDaemon,
    secure: Secure,
    authority: Authority,
    wrong: Callable[[Path, Authority], tuple[tuple[str, str], str]],
    said: str,
) -> None:
    certificate, ca = wrong(tmp_path, authority)
    secured = secure(certificate)
    daemon.tell()
    process = Process(write_config(tmp_path, secured.port, vehicle="truck-17", tls=(f'ca = "{ca}"',)))
    line = process.wait_said("its certificate is not believed")
    assert line == (
        f"faultline mqtt: localhost:{secured.port}: its certificate is not believed: {said}; check `ca` and `host`; "
        "it is tried again, records wait"
    )
    assert process.stop() == 0
    assert secured.backend.messages == []


def test_a_broker_that_asks_who_we_are_is_told(
    tmp_path: Path, daemon: FakeDaemon, secure: Secure, authority: Authority
) -> None:
    """The key as systemd hands it over."""
    secured = secure(
        authority.sign("broker", "localhost"),
        f"cafile {authority.path}",
        "require_certificate true",
        "allow_anonymous true",
    )
    ours = authority.sign("truck-17", "truck-17")
    told = daemon.tell()
    without = Process(write_config(tmp_path, secured.port, vehicle="truck-17", tls=(f'ca = "{authority.path}"',)))
    without.wait_said(f"localhost:{secured.port}: TLS failed: ")
    without.kill()
    rows = (f'ca = "{authority.path}"', f'certificate = "{ours[0]}"', 'key = "truck-17.key"')
    process = Process(write_config(tmp_path, secured.port, tls=rows), CREDENTIALS_DIRECTORY=str(tmp_path))
    secured.backend.wait(lambda: secured.backend.ids() == [told])
    assert process.stop() == 0


def test_a_broker_that_speaks_no_tls_is_said(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, authority: Authority
) -> None:
    process = Process(write_config(tmp_path, broker.port, vehicle="t", tls=(f'ca = "{authority.path}"',)))
    assert "check `port` and [mqtt.tls]" in process.wait_said(f"localhost:{broker.port}: ")
    assert process.stop() == 0


def test_tls_that_we_do_not_speak_is_said(
    tmp_path: Path, daemon: FakeDaemon, secure: Secure, authority: Authority
) -> None:
    secured = secure(authority.sign("broker", "localhost"))
    process = Process(write_config(tmp_path, secured.port, vehicle="t", host="127.0.0.1"))
    assert "it is tried again" in process.wait_said(f"127.0.0.1:{secured.port}: ")
    assert process.stop() == 0


@pytest.mark.parametrize("wrong", ["another", "encrypted"])
def test_a_key_that_cannot_be_used_is_refused_at_the_start(tmp_path: Path, authority: Authority, wrong: str) -> None:
    certificate, key = authority.sign("ours", "truck-17")
    encrypted = pem(ec.generate_private_key(ec.SECP256R1()), b"secret")
    Path(key).write_bytes(encrypted if wrong == "encrypted" else pem(ec.generate_private_key(ec.SECP256R1())))
    process = Process(write_config(tmp_path, 1, tls=(f'certificate = "{certificate}"', f'key = "{key}"')))
    assert process.wait() == 2
    [line] = process.said
    assert f"faultline mqtt: error: {certificate}, {key}: not our certificate and its key: " in line
    assert "(not encrypted)" in line


def passwords(folder: Path, **users: str) -> Path:
    """A password file as mosquitto has it: PBKDF2 with SHA-512."""
    path, salt = folder / "passwords", b"twelve bytes"
    rows = []
    for user, password in users.items():
        digest = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, 101)
        rows.append(f"{user}:$7$101${base64.b64encode(salt).decode()}${base64.b64encode(digest).decode()}\n")
    path.write_text("".join(rows))
    path.chmod(0o600)
    return path


def test_a_wrong_password_is_said_and_the_right_one_taken_without_a_restart(
    tmp_path: Path, daemon: FakeDaemon, secure: Secure, authority: Authority
) -> None:
    """And neither is told to anybody."""
    lines = ["allow_anonymous false", f"password_file {passwords(tmp_path, truck='right')}"]
    secured = secure(authority.sign("broker", "localhost"), *lines)
    told = daemon.tell()
    secret = tmp_path / "secret"
    secret.write_text("wrong\n")
    values = {"vehicle": "truck-17", "user": "truck", "password_file": str(secret)}
    process = Process(write_config(tmp_path, secured.port, tls=(f'ca = "{authority.path}"',), **values))
    said = process.wait_said("it refuses us")
    assert "check `user`" in said
    secret.write_text("right\n")
    secured.backend.wait(lambda: secured.backend.ids() == [told])
    assert process.stop() == 0
    assert not [line for line in process.said if "wrong" in line or "right" in line]


def test_a_password_file_that_is_not_there_is_refused_at_the_start(tmp_path: Path) -> None:
    process = Process(write_config(tmp_path, 1, user="truck", password_file=f"{tmp_path}/none"))
    assert process.wait() == 2
    assert process.said == [
        f"faultline mqtt: error: {tmp_path}/none: cannot be read: No such file or directory; "
        "give the password's file in `password_file`"
    ]
