"""Write the service's unit, configuration and network files onto a vehicle, or into its image."""

import argparse
import re
import sys
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import NamedTuple

from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.writing import write_files

EXAMPLE = """example, on the vehicle as root, or with --root while its image is made:
  python3 -m venv --copies /opt/faultline
  /opt/faultline/bin/pip install faultline_diagnosis-*.whl
  /opt/faultline/bin/faultline install --dry-run
  /opt/faultline/bin/faultline install --interface can0 --bitrate 250000
  cp fleet.pub /etc/faultline/keys/
  /opt/faultline/bin/faultline bundle install bundle --into /var/lib/faultline-bundles/uds --keys /etc/faultline/keys
  systemd-sysusers && sysctl --system && networkctl reload
  systemctl daemon-reload && systemctl enable --now faultline

The environment must not be in a home folder, which the service cannot see, and be made with --copies, as nothing but it
and the system's libraries may be executed. A configuration that is there is left as it is.
"""

START = (
    "systemd-sysusers && sysctl --system && networkctl reload && systemctl daemon-reload && "
    "systemctl enable --now faultline"
)
CONFIG = Path("/etc/faultline/faultline.toml")
KEYS = CONFIG.parent / "keys"
OUTPUTS = {"j1939": "j1939", "mqtt": "mqtt", "web": "serve"}
"""Units of the processes beside the service, which are enabled by whoever wants them, and their commands."""
BUNDLES = Path("/var/lib/faultline-bundles")
LIBRARIES = ("/usr/lib", "/usr/lib64", "/lib", "/lib64")
"""Where shared libraries are; one that is not there is no error (`-` in the unit)."""


class File(NamedTuple):
    """A file to write; one that is the vehicle's own is not replaced."""

    path: Path
    text: str
    keep: bool = False


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser("faultline install", description=__doc__, epilog=EXAMPLE)
    add = parser.add_argument
    add("--root", type=Path, default=Path("/"), metavar="DIR", help="the image's root (default: /)")
    add("--prefix", type=Path, default=Path(sys.prefix), help="the environment, as on the vehicle (default: this one)")
    add("--base", type=Path, default=Path(sys.base_prefix), help="the Python it was made of (default: this one's)")
    add("--interface", default="can0", metavar="NAME", help="of the bus (default: can0)")
    add("--bitrate", type=int, metavar="BIT/S", help="let networkd set it up so, listening only; else it is left alone")
    add("--virtual", action="store_true", help="let networkd make it a virtual bus, for trials")
    add("--dry-run", action="store_true", help="print what would be written, and write nothing")
    options = parser.parse_args(argv)
    _check(options)
    written = {}
    for file in _files(options):
        path = options.root / file.path.relative_to("/")
        kept = file.keep and path.exists()
        if options.dry_run:
            print(f"# {path}{' (is there, and kept)' if kept else ''}\n{file.text}")
        elif kept:
            print(f"kept   {path}")
        else:
            written[path] = file.text
    if not options.dry_run:
        _write(written)
        for path in written:
            print(f"wrote  {path}")
        keys, incoming = (options.root / path.relative_to("/") for path in (KEYS, BUNDLES / "incoming"))
        for folder in (keys, incoming.parent, incoming):
            _made(folder)
        print(f"then:  public keys of those who sign into {keys}, `faultline bundle install` where the configuration")
        print(f"       says, and {START}")
    return 0


def _check(options: argparse.Namespace) -> None:
    if re.fullmatch(r"[A-Za-z0-9_.-]{1,15}", options.interface) is None:
        raise InputError(f"--interface {options.interface}: no name of a network interface; give one as can0")
    if options.bitrate is not None and not 10_000 <= options.bitrate <= 1_000_000:
        raise InputError(f"--bitrate {options.bitrate}: from 10000 to 1000000 bit/s, as 250000")
    if options.bitrate is not None and options.virtual:
        raise InputError("--bitrate with --virtual: a virtual bus has none; leave one of them out")
    for name in ("prefix", "base"):
        path = getattr(options, name)
        if not path.is_absolute() or re.search(r"[\s%]", str(path)):
            raise InputError(f"--{name} {path}: give the whole path as it is on the vehicle, without spaces or %")
        if path.is_relative_to("/home") or path.is_relative_to("/root"):
            raise InputError(
                f"--{name} {path}: is in a home folder, which the service cannot see; "
                "make the environment as /opt/faultline, with a Python that is in /usr or /opt"
            )


def _files(options: argparse.Namespace) -> Iterator[File]:
    libraries = [] if options.base == Path("/usr") else [f"{options.base}/lib"]
    words = {
        "PREFIX": str(options.prefix),
        "CONFIG": str(CONFIG),
        "KEYS": str(KEYS),
        "EXEC": " ".join([str(options.prefix), *(f"-{path}" for path in (*libraries, *LIBRARIES))]),
        "INTERFACE": options.interface,
        "BITRATE": str(options.bitrate),
    }
    system, network = Path("/etc/systemd/system"), Path("/etc/systemd/network")
    yield File(system / "faultline.service", _text("faultline.service", words))
    yield File(system / "faultline-bundle@.service", _text("faultline-bundle@.service", words))
    yield File(CONFIG, _text("faultline.toml", words), keep=True)
    for output, command in OUTPUTS.items():
        yield File(system / f"faultline-{output}.service", _text(f"faultline-{output}.service", words))
        yield File(CONFIG.parent / f"{command}.toml", _text(f"{command}.toml", words), keep=True)
    yield File(Path("/etc/sysctl.d/60-faultline.conf"), _text("sysctl.conf", words))
    yield File(Path("/etc/sysusers.d/faultline.conf"), _text("sysusers.conf", words))
    if options.bitrate is not None:
        yield File(network / f"60-faultline-{options.interface}.network", _text("can.network", words))
    if options.virtual:
        for kind in ("netdev", "network"):
            yield File(network / f"60-faultline-{options.interface}.{kind}", _text(f"vcan.{kind}", words))


def _text(name: str, words: dict[str, str]) -> str:
    """A file of `service/vehicle` with its words in place of @NAME@."""
    text = resources.files("faultline.service").joinpath("vehicle", name).read_text()
    for word, value in words.items():
        text = text.replace(f"@{word}@", value)
    return text


def _write(files: dict[Path, str]) -> None:
    for path in files:
        _made(path.parent)
    try:
        write_files(files, 0o644)  # whatever the umask: the service runs as a user of its own
    except PermissionError as error:
        raise InputError(f"{error.filename}: {error.strerror}; be root, or give another --root") from error


def _made(folder: Path) -> None:
    try:
        for each in (*reversed(folder.parents), folder):
            if not each.exists():
                each.mkdir()
                each.chmod(0o755)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}; be root, or give another --root") from error
