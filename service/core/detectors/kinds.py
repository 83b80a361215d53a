"""The kind of a detector by its name, and in brief for tables."""

from faultline.service.core.manifest import CusumDetector, Detector


def kind_of(detector: Detector) -> str:
    """The name of its kind: the `kind` of the manifest."""
    return str(type(detector).__struct_config__.tag)


def brief(detector: Detector) -> str:
    """Kind (or side), nu where it has one, and J, in columns of 26 characters in all."""
    if isinstance(detector, CusumDetector):
        kind = kind_of(detector) if detector.side == "both" else detector.side
        return f"{kind:<9}{detector.nu:>7.2f}{detector.J:>10.1f}"
    return f"{kind_of(detector):<16}{detector.J:>10.1f}"
