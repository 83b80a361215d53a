"""An evaluator of the drives that tuning leaves out is native code where it can be had, with the same decisions."""

from faultline.analysis.graph.bank import GRAPH
from faultline.analysis.graph.runnable import Runnable
from faultline.service.core.manifest import Manifest
from faultline.service.core.residuals.evaluator import Evaluator, TickByTick
from faultline.service.core.signals.modes import ModeTracker


def evaluator_of(runnable: Runnable, manifest: Manifest) -> Evaluator:
    """Return an evaluator of the generators and hypotheses: compiled if Numba is there and they have no networks.

    Raises:
        InputError: the model divides by parameters that are zero.
    """
    compiled = None if runnable.networks else _compiled(runnable, manifest)
    modes = ModeTracker(manifest.modes, manifest.inputs, manifest.period_s)
    return compiled or TickByTick(runnable.fresh(manifest.evidence), modes)


def _compiled(runnable: Runnable, manifest: Manifest) -> Evaluator | None:
    try:
        from faultline.analysis.compiled.elements import NotCompiledError
        from faultline.analysis.compiled.evaluator import CompiledEvaluator
        from faultline.analysis.compiled.kernels import kernels_of
    except ModuleNotFoundError:
        return None
    evidence = manifest.evidence
    hypotheses = runnable.of_hypotheses(evidence).get(evidence.graph or "")
    try:
        kernels = kernels_of(runnable.graphs[GRAPH], hypotheses, len(evidence.hypotheses))
    except (NotCompiledError, OSError):  # networks, or no place to keep what is compiled: as on the vehicle then
        return None
    return CompiledEvaluator(manifest, kernels)
