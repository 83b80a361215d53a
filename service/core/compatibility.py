"""Compatibility of two bundles: with the same decisions, the diagnosis state of one is valid for the other."""

from faultline.service.core.manifest import Manifest


def are_compatible(one: Manifest, other: Manifest) -> bool:
    """Return True if the same frames give the same decisions; version, descriptions and provenance may differ."""
    return _deciding(one) == _deciding(other)


def _deciding(manifest: Manifest) -> tuple[object, ...]:
    graphs = [graph.file for graph in manifest.graphs] + [manifest.evidence.graph or ""]
    return (
        [manifest.files[name].sha256 for name in graphs if name],
        manifest.period_s,
        manifest.start_within_s,
        manifest.inputs,
        manifest.senders,
        manifest.buses,
        manifest.signals,
        manifest.units,
        manifest.generators,
        manifest.modes,
        manifest.detectors,
        [fault.name for fault in manifest.faults],
        [(disturbance.name, disturbance.equation) for disturbance in manifest.disturbances],
        [equation.name for equation in manifest.equations],
        manifest.evidence,
    )
