"""Analytical generators beside networks of the same test, and both together (thesis 6.3, 7.6 and 7.7).

Compared are generators of one test in different graphs of the bundle, over the blocks of the recordings. *Together*: a
block has an alarm where either has one, and can be told where either can tell.
"""

from collections.abc import Sequence
from itertools import groupby

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.analysis.evaluation.blocks import Blocks, joined
from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.intervals import Share, share
from faultline.analysis.evaluation.measure.roc import area
from faultline.analysis.evaluation.measure.signature import sensitive
from faultline.service.core.manifest import Generator
from faultline.service.core.signals.values import Mask

TOGETHER = "together"


class Method(msgspec.Struct, frozen=True, kw_only=True):
    """A generator of a test, or all of them together, over the blocks in which it could tell.

    `false`: fault-free blocks with an alarm; `found`: blocks with faults that the test is sensitive to; `crossed`:
    blocks with faults that it decouples, where an alarm misleads. `rms` is that of the fault-free residual [unit of the
    signal], `auc` over the faults that the test is sensitive to; None for all together.
    """

    test: str
    generator: str
    rms: float | None
    false: Share
    found: Share
    crossed: Share
    auc: float | None
    cannot_tell: float


def methods(of: Sequence[Facts], generators: Sequence[Generator], known: Sequence[str]) -> list[Method]:
    """All tests of which the bundle has more than one generator; none: there is nothing to compare."""
    found = []
    ordered = sorted(range(len(generators)), key=lambda row: (generators[row].test, row))
    for test, rows in groupby(ordered, key=lambda row: generators[row].test):
        columns = list(rows)
        if len(columns) > 1:
            found += [_method(of, generators, [column], known, test) for column in columns]
            found.append(_method(of, generators, columns, known, test))
    return found


def _method(
    of: Sequence[Facts], generators: Sequence[Generator], columns: list[int], known: Sequence[str], test: str
) -> Method:
    blocks = joined([one.blocks for one in of])
    sees = _seen(of, generators[columns[0]], known)
    tells = blocks.tells[:, columns].any(axis=1)
    alarms = (blocks.alarms & blocks.tells)[:, columns].any(axis=1)

    def of_those(chosen: Mask) -> Share:
        return share(int((alarms & chosen).sum()), int((tells & chosen).sum()))

    single = columns[0] if len(columns) == 1 else None
    return Method(
        test=test,
        generator=TOGETHER if single is None else generators[single].name,
        rms=None if single is None else _rms(of, single),
        false=of_those(~blocks.faulty),
        found=of_those(blocks.faulty & (sees == 1)),
        crossed=of_those(blocks.faulty & (sees == 0)),
        auc=None if single is None else _auc(blocks, single, sees),
        cannot_tell=round(1.0 - float(tells.mean()), 4) if tells.size else 0.0,
    )


def _seen(of: Sequence[Facts], generator: Generator, known: Sequence[str]) -> npt.NDArray[np.int64]:
    """For each block whether the test is sensitive to the recording's faults: 1, 0, or -1 where nobody knows."""
    marks = [sensitive(generator, one.case.faults, known) for one in of]
    return np.repeat([-1 if mark is None else int(mark) for mark in marks], [len(one.blocks.faulty) for one in of])


def _rms(of: Sequence[Facts], column: int) -> float | None:
    count = sum(int(one.usable[0, column]) for one in of)
    return float(np.sqrt(sum(float(one.square[0, column]) for one in of) / count)) if count else None


def _auc(blocks: Blocks, column: int, sees: npt.NDArray[np.int64]) -> float | None:
    scores = blocks.scores[:, 0, column]
    return area(scores[~blocks.faulty], scores[blocks.faulty & (sees == 1)])
