"""A discovery of made runs, small enough for a test: one effect hidden, three entries looked for."""

from functools import cache

from made_study import LIBRARY, Inline, study

from analysis.discrepancy.data import Data
from analysis.discrepancy.discover import Discovery, discover
from analysis.simulation import system_of

ENTRIES = ("full_open_gain", "offset_p_du", "lag_p_du")
GAIN = 0.15


@cache
def discovery(gain: float = GAIN) -> Discovery:
    """Of a valve that passes so much more when it is held open."""
    made = study(ENTRIES, {"full_open_gain": gain} if gain else {})
    model = made.model
    data = Data(model, system_of(model, model.calibrated), (), (), made.training, made.held)
    return discover(data, {name: LIBRARY[name] for name in ENTRIES}, Inline(), None, lambda *_: None)
