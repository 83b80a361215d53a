"""Whether a bundle can run live here: its signals come on a bus, and a tick is computed in good time."""

from statistics import median
from time import perf_counter

import numpy as np

from faultline.service.bundle.files import BundleError
from faultline.service.bundle.load import Bundle, verify_golden

PART = 0.1
"""Of the period that a tick's residuals may cost: the rest is for the bus, the decision and other bundles."""


def check_live(bundle: Bundle) -> None:
    """Check that the bundle can run on a bus of this machine, golden vectors included.

    Raises:
        BundleError: it cannot, and why.
    """
    if bundle.manifest.dbc is None:
        raise BundleError(
            f"{bundle.where}: has no DBC, so its signals come in tables (`faultline diagnose`); export it with --dbc"
        )
    verify_golden(bundle)
    period_s, cost_s = bundle.manifest.period_s, tick_cost_s(bundle)
    if cost_s > PART * period_s:
        raise BundleError(
            f"{bundle.where}: a tick costs {1e3 * cost_s:.2g} ms on this machine, more than a tenth of its period of "
            f"{1e3 * period_s:g} ms; export it with a longer period, or with fewer tests"
        )


def tick_cost_s(bundle: Bundle) -> float:
    """The median time that the residuals of a golden vector take [s]: of a busy machine's pauses it knows nothing."""
    bank, usable, taken = bundle.bank(), np.ones(len(bundle.manifest.inputs), dtype=np.bool_), []
    for z in np.array(bundle.golden.z):
        begin = perf_counter()
        bank.step(z, usable)
        taken.append(perf_counter() - begin)
    return median(taken)
