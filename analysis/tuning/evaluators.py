"""Drives are evaluated and decided in native code where it can be had, with the same decisions.

Compiling takes some 20 s, once a model: for a few short drives that is longer than they take without.
"""

from collections.abc import Sequence
from typing import NamedTuple

from faultline.analysis.graph.bank import GRAPH
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.recordings.modes import modes_of
from faultline.service.core.decision.parts import PARTS, Parts
from faultline.service.core.manifest import Evidence, Generator, Input, Manifest, Modes
from faultline.service.core.residuals.evaluator import Evaluator, TickByTick
from faultline.service.core.signals.modes import ModeTracker


class _Residuals(NamedTuple):
    """Stands in for a manifest where generators are evaluated without hypotheses."""

    generators: Sequence[Generator]
    inputs: Sequence[Input]
    modes: Modes
    period_s: float
    evidence: Evidence | None = None


def evaluator_of(runnable: Runnable, manifest: Manifest, ticks: int, more: int) -> tuple[Evaluator, Parts]:
    """Return an evaluator of the generators and hypotheses, and the parts of the decision.

    They are for so many `ticks`; others will be wanted for `more`.

    Both are native if Numba is there, the bundle has no networks, and it is worth it or was compiled before.

    Raises:
        InputError: the model divides by parameters that are zero.
    """
    native = _native(runnable, manifest, ticks, more)
    if native is not None:
        return native
    modes = ModeTracker(manifest.modes, manifest.inputs, manifest.period_s)
    return TickByTick(runnable.fresh(manifest.evidence), modes), PARTS


def residuals_of(runnable: Runnable) -> Evaluator:
    """Return an evaluator of the generators alone: native if it could be, and was compiled before.

    Raises:
        InputError: the model divides by parameters that are zero.
    """
    model, inputs = runnable.bank.model, runnable.bank.inputs
    what = _Residuals(runnable.generators, inputs, modes_of(model), model.period_s)
    native = _native(runnable, what)
    if native is not None:
        return native[0]
    return TickByTick(runnable.fresh(), ModeTracker(what.modes, inputs, model.period_s))


def _native(
    runnable: Runnable, what: Manifest | _Residuals, ticks: int = 0, more: int = 0
) -> tuple[Evaluator, Parts] | None:
    if runnable.networks:
        return None
    try:
        from faultline.analysis.compiled.decision import NATIVE
        from faultline.analysis.compiled.elements import NotCompiledError
        from faultline.analysis.compiled.evaluator import CompiledEvaluator
        from faultline.analysis.compiled.kernels import kernels_of
    except ModuleNotFoundError:
        return None
    evidence = what.evidence
    hypotheses = runnable.of_hypotheses(evidence).get(evidence.graph or "") if evidence else None
    rows = len(evidence.hypotheses) if evidence else 0
    try:
        kernels = kernels_of(runnable.graphs[GRAPH], hypotheses, rows, ticks=ticks, more=more)
    except (NotCompiledError, OSError):  # networks, or no place to keep what is compiled: as on the vehicle then
        return None
    return CompiledEvaluator(what, kernels), NATIVE
