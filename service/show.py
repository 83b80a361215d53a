"""Show or verify a bundle."""

import argparse
from pathlib import Path

import msgspec

from service.bundle import Bundle, load_bundle, verify_golden

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
        f"{m.name}, {m.schema}, id {bundle.id}",
        f"sensor set {m.sensor_set}, a tick every {m.period_s:g} s, model {m.origin.model_sha256[:12]}",
        "inputs: " + ", ".join(f"{i.signal} [{i.unit}]" for i in m.inputs),
        "",
        f"{'generator':<12}{'predicts':<10}{'nu':>6}{'J':>8}  " + " ".join(f"{name:>8}" for name in faults),
    ]
    for generator, detector in zip(m.generators, m.detectors, strict=True):
        marks = " ".join(f"{'X' if name in generator.faults else '.':>8}" for name in faults)
        lines.append(f"{generator.name:<12}{generator.predicts:<10}{detector.nu:>6.2f}{detector.J:>8.1f}  {marks}")
    lines += ["", *(f"{fault.name:<9} {fault.component}: {fault.description}" for fault in m.faults)]
    lines += ["", "equations, near which an unknown fault may be:"]
    lines += [f"{equation.name:<9} {equation.description}" for equation in m.equations]
    return "\n".join(lines)
