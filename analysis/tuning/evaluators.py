"""Drives that tuning leaves out are evaluated and decided in native code where it can be had, with the same decisions.

Compiling takes about a minute, once a model: for a few short drives that is longer than they take without.
"""

from faultline.analysis.graph.bank import GRAPH
from faultline.analysis.graph.runnable import Runnable
from faultline.service.core.decision.parts import PARTS, Parts
from faultline.service.core.manifest import Manifest
from faultline.service.core.residuals.evaluator import Evaluator, TickByTick
from faultline.service.core.signals.modes import ModeTracker

COMPILED = 20_000
"""Ticks from which it is worth it: without, 20,000 take as long as compiling does."""


def evaluator_of(runnable: Runnable, manifest: Manifest, ticks: int) -> tuple[Evaluator, Parts]:
    """Return an evaluator of the generators and hypotheses, and the parts of the decision, for so many ticks in all.

    Both are native if Numba is there, the bundle has no networks, and it is worth it or was compiled before.

    Raises:
        InputError: the model divides by parameters that are zero.
    """
    native = None if runnable.networks else _native(runnable, manifest, compiles=ticks >= COMPILED)
    if native is not None:
        return native
    modes = ModeTracker(manifest.modes, manifest.inputs, manifest.period_s)
    return TickByTick(runnable.fresh(manifest.evidence), modes), PARTS


def _native(runnable: Runnable, manifest: Manifest, *, compiles: bool) -> tuple[Evaluator, Parts] | None:
    try:
        from faultline.analysis.compiled.decision import NATIVE
        from faultline.analysis.compiled.elements import NotCompiledError
        from faultline.analysis.compiled.evaluator import CompiledEvaluator
        from faultline.analysis.compiled.kernels import kernels_of
    except ModuleNotFoundError:
        return None
    evidence = manifest.evidence
    hypotheses = runnable.of_hypotheses(evidence).get(evidence.graph or "")
    try:
        kernels = kernels_of(runnable.graphs[GRAPH], hypotheses, len(evidence.hypotheses), compiles=compiles)
    except (NotCompiledError, OSError):  # networks, or no place to keep what is compiled: as on the vehicle then
        return None
    return CompiledEvaluator(manifest, kernels), NATIVE
