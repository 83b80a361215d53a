"""Show, verify, sign or install a bundle."""

import argparse
import getpass
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from faultline.options import Parser
from faultline.service.bundle.files import MANIFEST, Trust
from faultline.service.bundle.load import Bundle, load_bundle, verify_golden
from faultline.service.core.detectors.kinds import brief
from faultline.service.core.errors import InputError
from faultline.writing import write_file

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

EXAMPLE = """example:
  faultline bundle show bundle
  faultline bundle verify bundle --keys keys
  openssl genpkey -algorithm ed25519 -aes256 -out fleet.pem
  faultline bundle public fleet.pem --out keys/fleet.pub
  faultline bundle sign bundle --key fleet.pem
  faultline bundle install bundle --into /var/lib/faultline-bundles/uds --keys /etc/faultline/keys

The password of an encrypted key is asked for, or taken from the environment's FAULTLINE_KEY_PASSWORD.
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = Parser("faultline bundle", description=__doc__, epilog=EXAMPLE)
    actions = parser.add_subparsers(dest="action", required=True)
    show = actions.add_parser("show", help="what is in it")
    show.add_argument("bundle", type=Path)
    show.add_argument("--json", action="store_true", help="the manifest as JSON")
    verify = actions.add_parser("verify", help="seal, hashes and golden vectors; with --keys its signatures too")
    verify.add_argument("bundle", type=Path)
    verify.add_argument("--keys", type=Path, metavar="DIR", help="folder of the trusted public keys *.pub")
    verify.add_argument("--signatures", type=int, default=1, metavar="N", help="by how many of them (default: 1)")
    sign = actions.add_parser("sign", help="add a signature, after verifying it")
    sign.add_argument("bundle", type=Path)
    sign.add_argument("--key", type=Path, required=True, help="private ed25519 key in PEM")
    sign.add_argument("--comment", default="", help="signed too (default: name, version and id of the bundle)")
    public = actions.add_parser("public", help="write the public key of a private one")
    public.add_argument("key", type=Path, help="private ed25519 key in PEM")
    public.add_argument("--out", type=Path, required=True, help="file to write, as keys/fleet.pub")
    install = actions.add_parser("install", help="try it and swap it in, if it is signed and not older than before")
    install.add_argument("bundle", type=Path)
    install.add_argument("--into", type=Path, required=True, metavar="DIR", help="folder of the two slots")
    install.add_argument("--keys", type=Path, metavar="DIR", help="folder of the trusted public keys *.pub")
    install.add_argument("--signatures", type=int, default=1, metavar="N", help="by how many of them (default: 1)")
    install.add_argument("--allow-unsigned", action="store_true", help="instead of --keys, for trials")
    options = parser.parse_args(argv)
    run = {"show": _show, "verify": _verify, "sign": _sign, "public": _public, "install": _install}[options.action]
    return run(options)


def _show(options: argparse.Namespace) -> int:
    bundle = load_bundle(options.bundle)
    print(msgspec.json.encode(bundle.manifest).decode() if options.json else _summary(bundle))
    return 0


def _verify(options: argparse.Namespace) -> int:
    trust = _trust(options)
    bundle = load_bundle(options.bundle, trust)
    verify_golden(bundle)
    ticks, files = len(bundle.golden.z), len(bundle.manifest.files)
    signed = f"signed by {options.signatures} trusted key{'s' if options.signatures > 1 else ''} at least"
    print(
        f"{options.bundle}: the seal holds, {files} files are whole, {ticks} golden vectors agree; "
        f"{'nobody was asked who signed it' if trust is None else signed}; id {bundle.id}"
    )
    return 0


def _trust(options: argparse.Namespace) -> Trust | None:
    if options.signatures < 1:
        raise InputError(f"--signatures {options.signatures}: at least 1")
    if options.keys is None:
        return None
    from faultline.service.bundle.signing import Signed, load_keys  # with a cryptographic library, which `show` lacks

    return Signed(load_keys(options.keys), options.signatures)


def _install(options: argparse.Namespace) -> int:
    from faultline.service.bundle.slots import Slots
    from faultline.service.bundle.trial import trial

    trust = _trust(options)
    if (trust is None) != options.allow_unsigned:
        raise InputError("install: give --keys, or --allow-unsigned for a trial; one of them")
    slots = Slots(options.into)
    given = slots.install(options.bundle, trust, trial)
    print(
        f"{options.into}: {given.manifest.name} version {given.manifest.version}, id {given.id[:12]}, "
        f"is current, in slot {slots.current}"
    )
    return 0


def _sign(options: argparse.Namespace) -> int:
    from faultline.service.bundle.signing import SUFFIX, public_of, sign

    private = _private(options.key)
    bundle = load_bundle(options.bundle)
    verify_golden(bundle)
    path = options.bundle / f"manifest.{public_of(private).label}{SUFFIX}"
    comment = options.comment or f"{bundle.manifest.name} version {bundle.manifest.version} id {bundle.id}"
    if "\n" in comment or "\r" in comment:
        raise InputError("--comment: is one line; give one")
    write_file(path, sign((options.bundle / MANIFEST).read_bytes(), private, comment))
    print(f"wrote {path}: {comment}")
    return 0


def _public(options: argparse.Namespace) -> int:
    from faultline.service.bundle.signing import public_of, public_text

    key = public_of(_private(options.key))
    write_file(options.out, public_text(key))
    print(f"wrote {options.out}: key {key.label}")
    return 0


def _private(path: Path) -> "Ed25519PrivateKey":
    from faultline.service.bundle.signing import SignatureError, load_private

    given = os.environ.get("FAULTLINE_KEY_PASSWORD")
    try:
        return load_private(path, given.encode() if given is not None else None)
    except SignatureError as error:
        if "is encrypted" not in str(error) or not sys.stdin.isatty():
            raise
        return load_private(path, getpass.getpass(f"password of {path}: ").encode())


def _summary(bundle: Bundle) -> str:
    m = bundle.manifest
    faults = [fault.name for fault in m.faults]
    lines = [
        f"{m.name}, version {m.version}, {m.schema}, id {bundle.id}",
        f"sensor set {m.sensor_set}, a tick every {m.period_s:g} s, model {m.origin.model_sha256[:12]}, "
        f"vehicle {m.origin.vehicle or 'unknown'}",
        "inputs: " + ", ".join(f"{i.signal} [{i.unit}]" for i in m.inputs),
        "",
        f"{'generator':<12}{'predicts':<10}{'detector, nu, J':<26}  " + " ".join(f"{name:>8}" for name in faults),
    ]
    for generator in m.generators:
        marks = " ".join(f"{'X' if name in generator.faults else '.':>8}" for name in faults)
        first, *more = [brief(detector) for detector in m.detectors if detector.generator == generator.name]
        lines.append(f"{generator.name:<12}{generator.predicts:<10}{first:<26}  {marks}")
        lines += [f"{'':<22}{settings}" for settings in more]
    lines += ["", "false alarms: nothing is claimed of them" if m.claim is None else m.claim.said]
    if m.origin.base is not None:
        whose = "" if m.claim is None else ", whose claim this is"
        lines.append(f"adapted to this vehicle from the tuning {m.origin.base[:12]} of others{whose}")
    lines += [
        "",
        *(f"{fault.name:<9} {': '.join(filter(None, (fault.component, fault.description)))}" for fault in m.faults),
    ]
    lines += ["", "equations, near which an unknown fault may be:"]
    disturbing = {each.equation: f"; {each.name}: {each.description}" for each in m.disturbances}
    lines += [f"{e.name:<9} {e.description}{disturbing.get(e.name, '')}" for e in m.equations]
    return "\n".join(lines)
