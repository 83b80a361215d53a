"""Show or verify a bundle."""

import argparse
from pathlib import Path

import msgspec

from service.bundle import Bundle, load_bundle, verify_golden
from service.core.manifest import brief

EXAMPLE = """example:
  faultline bundle show bundle
  faultline bundle verify bundle
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        "faultline bundle", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "action", choices=["show", "verify"], help="show: what is in it; verify: seal, hashes and golden vectors"
    )
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--json", action="store_true", help="show: the manifest as JSON")
    options = parser.parse_args(argv)
    bundle = load_bundle(options.bundle)
    if options.action == "verify":
        verify_golden(bundle)
        ticks = len(bundle.golden.z)
        files = len(bundle.manifest.files)
        print(
            f"{options.bundle}: the seal holds, {files} files are whole, {ticks} golden vectors agree; id {bundle.id}"
        )
    elif options.json:
        print(msgspec.json.encode(bundle.manifest).decode())
    else:
        print(_summary(bundle))
    return 0


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
    lines += ["", *(f"{fault.name:<9} {fault.component}: {fault.description}" for fault in m.faults)]
    lines += ["", "equations, near which an unknown fault may be:"]
    disturbing = {each.equation: f"; {each.name}: {each.description}" for each in m.disturbances}
    lines += [f"{e.name:<9} {e.description}{disturbing.get(e.name, '')}" for e in m.equations]
    return "\n".join(lines)
