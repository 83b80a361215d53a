"""Networks for another vehicle: of each test what errs least, as it was, adapted, or trained anew (thesis 8.2.5)."""

from collections.abc import Callable

import torch

from faultline.service.core.errors import InputError
from faultline.training.device import CPU
from faultline.training.layout import Layout
from faultline.training.loop import Report, Training
from faultline.training.samples import Samples
from faultline.training.saved import Saved


def trained_anew(
    adapted: Training,
    layout: Layout,
    samples: Samples,
    begin: Saved,
    seed: int,
    tell: Callable[[Report], None],
    device: torch.device = CPU,
) -> list[str]:
    """Train others on the same recording, and give the tests to `adapted` in which they err less where held out.

    Returns the names of these tests; none where the training diverges, as one on a short recording may.
    """
    anew = Training(layout, samples, begin.recipe, seed, None, device, adapted.scaling)
    try:
        anew.run(tell, lambda: None)
    except InputError:  # what was adapted stays as good as it is
        return []
    return adapted.take(anew)
