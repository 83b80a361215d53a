"""Networks for another vehicle, of each test: trained anew, or adapted where that errs clearly less (thesis 8.2.5).

What is held out of a short recording is of the same drive, and hardly tells what other drives will show: of two that
err alike there, the adapted one erred up to 2.6 times as much on other recordings of four development trucks.
"""

from collections.abc import Callable

import torch

from faultline.service.core.errors import InputError
from faultline.training.device import CPU
from faultline.training.layout import Layout
from faultline.training.loop import Report, Training
from faultline.training.samples import Samples
from faultline.training.saved import Saved

CLEARLY = 0.8
"""Times the error of a test that was trained anew: what was adapted is kept below it."""


def trained_anew(
    adapted: Training,
    layout: Layout,
    samples: Samples,
    begin: Saved,
    seed: int,
    tell: Callable[[Report], None],
    device: torch.device = CPU,
) -> list[str]:
    """Train others on the same recording, and give the tests to `adapted` in which it does not err clearly less.

    Returns the names of these tests; none where the training diverges, as one on a short recording may.
    """
    anew = Training(layout, samples, begin.recipe, seed, None, device, adapted.scaling)
    try:
        anew.run(tell, lambda: None)
    except InputError:  # what was adapted stays as good as it is
        return []
    return adapted.take(anew, CLEARLY)
