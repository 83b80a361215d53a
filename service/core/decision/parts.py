"""Parts of the decision that take most of its time. Off the vehicle native code may stand in for them."""

from typing import NamedTuple

from faultline.service.core.decision.change_detector import ChangeDetector
from faultline.service.core.decision.look import Look
from faultline.service.core.detectors.cusum import Cusums


class Parts(NamedTuple):
    """Their classes: the CUSUMs, the change detector, and the look at a window."""

    cusums: type[Cusums] = Cusums
    changes: type[ChangeDetector] = ChangeDetector
    look: type[Look] = Look


PARTS = Parts()
"""The parts that run on the vehicle."""
