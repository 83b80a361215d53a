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
    known = fit.system.model.known
    for recording, validation in validations.items():
        for name, by_mode in validation.agreement.items():
            for mode, a in by_mode.items():
                if mode not in (EDGE, STEADY) and a.normalised > TWICE:
                    yield (
                        f"{recording}: the free run of {name} is off by {float(f'{a.rms:.3g}'):g} {known[name].unit} "
                        f"in mode {mode}; sample by sample that is {a.normalised:.1f} times what is expected"
                    )


def _of_fit(fit: Fit) -> Iterator[str]:
    known = fit.system.model.known
    for name, value in fit.unknowns.zero(fit.x).items():
        usual = known[name].zero
        if abs(value) > UNLIKELY * usual:
            yield f"the zero error of {name} is {value:.0f} {known[name].unit}, {usual:g} is usual"
    for name, x in zip(fit.unknowns.parameters, fit.x.tolist(), strict=False):
        if abs(x) > UNLIKELY:
            yield f"{name} is {abs(x):.1f} standard deviations of its prior away from the model file's value"
    for name in fit.at_bound:
        yield f"{name} has run into its bound"
    if 2 * fit.starts[1] < fit.starts[0]:
        yield f"only {fit.starts[1]} of {fit.starts[0]} searches came to the same place"
