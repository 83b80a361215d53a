"""What a bundle says of its generators, as arrays: T generators with nx states, of nz input signals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from faultline.service.core.manifest import Evidence, Generator, Input
from faultline.service.core.signals.regions import Regions
from faultline.service.core.signals.values import FloatArray, Indices, Mask
from faultline.service.core.time_scale import ticks_of

STALE = 0.3
"""A sample older than this part of its `maximum_age_s`, of five periods, stands for one or more that were lost."""


class GeneratorTable(NamedTuple):
    """The operating region `lower` to `upper` (nz,), and from which age on a sample is `stale` (nz,) [s].

    Each generator `needs` (T, nz) some inputs and takes `warm_up` (T,) ticks. A state's `owner` (nx,) is its generator;
    it starts at offset + gain z, with (nx,) and (nx, nz). `consequences` (C,) are those of the evidence. Of the K
    generators that have hypotheses, `weighed` (K,) are their rows, `own` the columns of their states, `own_owner` which
    of the K has each.
    """

    lower: FloatArray
    upper: FloatArray
    stale: FloatArray
    needs: Mask
    warm_up: Indices
    owner: Indices
    offset: FloatArray
    gain: FloatArray
    consequences: Regions
    weighed: Indices
    own: Indices
    own_owner: Indices


def table_of(
    generators: Sequence[Generator], inputs: Sequence[Input], period_s: float, evidence: Evidence | None
) -> GeneratorTable:
    """Return the table of a bundle's generators."""
    names = [channel.signal for channel in inputs]
    states = [(row, state) for row, generator in enumerate(generators) for state in generator.states]
    gain = np.zeros((len(states), len(names)))
    for column, (_, state) in enumerate(states):
        for signal, value in state.gain.items():
            gain[column, names.index(signal)] = value
    needs = np.zeros((len(generators), len(names)), dtype=np.bool_)
    for row, generator in enumerate(generators):
        needs[row, [names.index(signal) for signal in generator.inputs]] = True
    owner = np.array([row for row, _ in states], dtype=np.intp)
    rows = [generator.name for generator in generators]
    has_hypotheses = evidence is not None and evidence.graph is not None
    weighed = [rows.index(name) for name in evidence.generators] if evidence is not None and has_hypotheses else []
    own = [np.flatnonzero(owner == row) for row in weighed]
    return GeneratorTable(
        lower=np.array([channel.lower for channel in inputs]),
        upper=np.array([channel.upper for channel in inputs]),
        stale=STALE * np.array([channel.maximum_age_s for channel in inputs]),
        needs=needs,
        warm_up=np.array([ticks_of(generator.warm_up_s, period_s) for generator in generators]),
        owner=owner,
        offset=np.array([state.offset for _, state in states]),
        gain=gain,
        consequences=Regions([each.where for each in evidence.consequences] if evidence is not None else [], inputs),
        weighed=np.array(weighed, dtype=np.intp),
        own=np.concatenate([np.zeros(0, np.intp), *own]),
        own_owner=np.repeat(np.arange(len(weighed)), [len(each) for each in own]),
    )
