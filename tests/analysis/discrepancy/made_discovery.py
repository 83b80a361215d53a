"""A discovery of made runs, small enough for a test: one effect hidden, three entries looked for."""

import dataclasses

from made_study import LIBRARY, Inline, study
from once import once

from faultline.analysis.discrepancy.data import Data
from faultline.analysis.discrepancy.discover import Discovery, discover
from faultline.analysis.simulation import system_of

ENTRIES = ("full_open_gain", "offset_p_du", "lag_p_du")
GAIN = 0.15


@once
def discovery(gain: float = GAIN, own: str | None = None) -> Discovery:
    """Of a valve that passes so much more when it is held open; the entry `own` is of a user's file."""
    made = study(ENTRIES, {"full_open_gain": gain} if gain else {})
    model = made.model
    data = Data(model, system_of(model, model.calibrated), (), (), made.training, made.held)
    library = {name: LIBRARY[name] for name in ENTRIES}
    if own is not None:
        library[own] = dataclasses.replace(LIBRARY[own], place=f"own.toml: effect {own}")
    return discover(data, library, Inline(), None, lambda *_: None)
