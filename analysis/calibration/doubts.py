"""Whether a model that has been fitted describes the data at all: nobody needs to know what good figures look like."""

from collections.abc import Iterator, Mapping

from faultline.analysis.calibration.fit import Fit
from faultline.analysis.calibration.validate import STEADY, Validation
from faultline.service.core.manifest import EDGE

UNLIKELY = 3.0
"""Standard deviations of a prior: what is further away is not what the model file says."""

TWICE = 2.0
"""Times the expected error, sample by sample, in a steady mode: the model misses something."""


def doubts(fit: Fit, validations: Mapping[str, Validation]) -> Iterator[str]:
    """The reasons why it does not, none if it does; `validations` are the free runs by recording."""
    yield from _of_fit(fit)
    known, settling_s = fit.system.model.known, fit.system.model.settling_s
    for recording, validation in validations.items():
        yield from _unphysical(recording, validation)
        for name, by_mode in validation.agreement.items():
            for mode, a in by_mode.items():
                if mode not in (EDGE, STEADY) and a.normalised > TWICE:
                    yield (
                        f"{recording}: the free run of {name} is off by {float(f'{a.rms:.3g}'):g} {known[name].unit} "
                        f"in mode {mode}; sample by sample that is {a.normalised:.1f} times what is expected, most "
                        f"from {a.worst_s:.0f} to {a.worst_s + settling_s:.0f} s of the log: leave that out if "
                        "something happened there, else let `faultline discover` look for what the model lacks"
                    )


def _unphysical(recording: str, validation: Validation) -> Iterator[str]:
    """The unknowns that the model has below what is physical: one sentence each, where it is worst."""
    least: dict[str, tuple[float, float]] = {}  # value, and when [s]
    for section, trajectory in zip(validation.sections, validation.trajectories, strict=True):
        for name, w in zip(map(str, trajectory.system.variables), trajectory.w.T, strict=True):
            found = float(w.min()), section.start_s + float(section.t[w.argmin()])
            least[name] = min(found, least.get(name, found))
    for name, unknown in validation.trajectories[0].system.model.unknown.items() if least else ():
        if unknown.min is not None and name in least and least[name][0] < unknown.min:
            value, t_s = least[name]
            yield (
                f"{recording}: at {t_s:.0f} s {name} would be {value:.3g} {unknown.unit}, and nothing below "
                f"{unknown.min:g} {unknown.unit} is physical; give the parameters that make it tighter priors"
            )


def _of_fit(fit: Fit) -> Iterator[str]:
    known = fit.system.model.known
    for name, value in fit.unknowns.zero(fit.x).items():
        usual = fit.unknowns.zeros[name]
        if abs(value) > UNLIKELY * usual:
            yield f"the zero error of {name} is {value:.0f} {known[name].unit}, {usual:g} is usual"
    for name, x in zip(fit.unknowns.parameters, fit.x.tolist(), strict=False):
        if abs(x) > UNLIKELY:
            yield f"{name} is {abs(x):.1f} standard deviations of its prior away from the model file's value"
    for name in fit.at_bound:
        yield f"{name} has run into its bound"
    if 2 * fit.starts[1] < fit.starts[0]:
        yield f"only {fit.starts[1]} of {fit.starts[0]} searches came to the same place"
