"""What a calibration found, as JSON, as text and as a picture like the thesis's Fig. 5.10."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from faultline.analysis.calibration.doubts import TWICE, doubts
from faultline.analysis.calibration.fit import Fit, Globally
from faultline.analysis.calibration.identify import Identified
from faultline.analysis.calibration.pulses import Pulses
from faultline.analysis.calibration.pulses import sentences as of_pulses
from faultline.analysis.calibration.validate import STEADY, Agreement, Validation
from faultline.analysis.model import Known, Model
from faultline.analysis.model.display import Units, units_of
from faultline.service.core.display import Display
from faultline.service.core.manifest import EDGE

CORRELATED = 0.9
"""Parameters that are correlated more than this are hard to tell apart."""

STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#e5a58a", "linewidth": 2.2},
    {"color": "#1b4332", "linewidth": 0.8, "linestyle": "--"},
)
"""Of the models in a picture: the one calibrated, and the one beside it."""


class Parameter(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter, in `unit`: in the model file and fitted, standard errors of its logarithm, and 95 % intervals.

    Those called relative are with the anchors as they are. `told` is whether the data tell it, not the prior alone. The
    standard errors of an `absolute` one, which may be zero or negative, are its own.
    """

    unit: str
    prior_value: float
    value: float
    spread: float
    relative_spread: float
    interval: tuple[float, float]
    relative_interval: tuple[float, float]
    told: bool
    absolute: bool


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """What `calibrate` tells. `agreement` is by recording, output and mode, all in the output's unit.

    `doubts` are the reasons why the model does not describe these data. `anchors` name what only the prior scales, with
    the parameters known relative to it; `correlated` are all pairs that are told; `zeros` are the sensors' zero errors,
    `delays` the commands' [s]; of `starts` searches so many came to the best place, those that followed on a global
    search if `globally` tells of one. `pulses` are in a written report only. `misfits` are modes, edges, ranges and
    ages of the model that do not fit the recordings.
    """

    model: str
    vehicle: str | None
    sources: tuple[str, ...]
    parameters: dict[str, Parameter]
    doubts: tuple[str, ...]
    anchors: dict[str, tuple[str, ...]]
    correlated: tuple[tuple[str, str, float], ...]
    zeros: dict[str, float]
    delays: dict[str, float]
    starts: tuple[int, int]
    agreement: dict[str, dict[str, dict[str, Agreement]]]
    pulses: Pulses | None = None
    misfits: tuple[str, ...] = ()
    globally: Globally | None = None


def report(
    model: Model,
    vehicle: str | None,
    sources: Sequence[str],
    fit: Fit,
    found: Identified,
    validations: Mapping[str, Validation],
    misfits: Sequence[str] = (),
) -> Report:
    """The report of a fit of `model`, with the free runs over each recording; `sources` say where those come from."""
    return Report(
        model=model.name,
        vehicle=vehicle,
        sources=tuple(sources),
        parameters={
            name: Parameter(
                unit=model.parameters[name].unit,
                prior_value=model.parameters[name].value,
                value=e.value,
                spread=e.spread,
                relative_spread=e.relative_spread,
                interval=e.interval(e.spread),
                relative_interval=e.interval(e.relative_spread),
                told=e.told,
                absolute=e.absolute,
            )
            for name, e in found.estimates.items()
        },
        doubts=tuple(doubts(fit, validations)),
        anchors=found.anchors,
        correlated=found.correlated,
        zeros=fit.unknowns.zero(fit.x),
        delays=fit.unknowns.delay(fit.x),
        starts=fit.starts,
        agreement={recording: validation.agreement for recording, validation in validations.items()},
        misfits=tuple(misfits),
        globally=fit.globally,
    )


def sentences(r: Report, known: Mapping[str, Known]) -> list[str]:
    """The report as lines of text."""
    lines = [f"the model does NOT describe these data: {doubt}" for doubt in r.doubts] or [_accepted(r)]
    lines += [f"a setting to check, not the equations: {misfit}" for misfit in r.misfits]
    lines += [f"{'parameter':<10}{'model file':>12}{'calibrated':>12}{'95 %':>9}  unit"]
    lines += [_row(name, p, r) for name, p in r.parameters.items()]
    for anchor, others in r.anchors.items():
        lines.append(
            f"{anchor}, {', '.join(others)} are known up to one common factor only: no signal tells their scale. "
            f"{anchor} is the anchor, which its prior tells to "
            f"{_width(r.parameters[anchor], r.parameters[anchor].interval)}; the 95 % of the others take it as it is"
        )
    for first, second, correlation in r.correlated:
        if abs(correlation) > CORRELATED:
            lines.append(f"{first} and {second} are hard to tell apart (correlation {correlation:+.2f})")
    lines += [f"sensor {name}: zero error {value:+.3g} {known[name].unit}" for name, value in r.zeros.items()]
    lines += [f"command {name}: acts {value:+.3f} s after it is logged" for name, value in r.delays.items()]
    lines += [] if r.globally is None else [_of_global_search(r.globally)]
    lines.append(f"{r.starts[1]} of {r.starts[0]} searches came to the same place")
    for recording, by_output in r.agreement.items():
        lines.append(f"free run over {recording}: RMS error, and over how the channel flickers by itself")
        modes = list(dict.fromkeys(mode for by_mode in by_output.values() for mode in by_mode))
        lines.append(f"  {'':<14}" + "".join(f" {mode:>20}" for mode in modes))
        for name, by_mode in by_output.items():
            told = {mode: f"{_number(a.rms)} ({_times_floor(a) or 'too short'})" for mode, a in by_mode.items()}
            lines.append(
                f"  {name + f' [{known[name].unit}]':<14}" + "".join(f" {told.get(m, '-'):>20}" for m in modes)
            )
    if r.pulses is not None:
        lines += of_pulses(r.pulses)
    return lines


def _of_global_search(found: Globally) -> str:
    unrun = f" ({found.failed} could not be run)" if found.failed else ""
    ended = f"ended {found.gain:.0f} nats better" if found.gain >= 1.0 else "found nothing better"
    return (
        f"{found.reason}, so {found.tried} sets of parameters all over the priors were tried{unrun}; the searches from "
        f"the best of them {ended}"
    )


def _accepted(r: Report) -> str:
    steady = [
        (a.normalised, name, mode)
        for by_output in r.agreement.values()
        for name, by_mode in by_output.items()
        for mode, a in by_mode.items()
        if mode not in (EDGE, STEADY)
    ]
    most, name, mode = max(steady, default=(0.0, "", ""))
    return (
        f"the model describes these data: sample by sample it is off by at most {most:.1f} times what is expected "
        f"({name} in mode {mode}; {TWICE:g} times are allowed)"
    )


def _row(name: str, p: Parameter, r: Report) -> str:
    if name in r.anchors:
        tells = "anchor"
    elif not p.told:
        tells = "not told"
    else:
        tells = _width(p, p.relative_interval)
    return f"{name:<10}{p.prior_value:>12.4g}{p.value:>12.4g}{tells:>9}  {p.unit}"


def _width(p: Parameter, interval: tuple[float, float]) -> str:
    """Half the width of an interval: in per cent of its middle, or of an absolute parameter in its unit."""
    low, high = interval
    if p.absolute:
        return f"+-{(high - low) / 2:.2g}"
    percent = 50.0 * float(np.log(high / low))
    return f"{percent:.0f} %" if percent >= 10 else f"{percent:.2g} %"


def _number(value: float) -> str:
    """Three digits, or all before the point: an error may be of Pa or of V."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _times_floor(a: Agreement) -> str:
    """The error in parts of the noise floor; nothing where the mode is too short for a floor."""
    return f"{a.rms / a.floor:.2f}x" if a.floor > 0 else ""


def page(r: Report, known: Mapping[str, Known], picture: str) -> str:
    """The report as Markdown, with its picture."""
    body = "\n".join(sentences(r, known))
    of = f" of vehicle {r.vehicle}" if r.vehicle else ""
    steady = [
        f"| {recording} | {name} | {a.rms:.4g} | "
        + (f"{a.floor:.4g} | {times} | {a.expected:.4g} |" if (times := _times_floor(a)) else "too short | | |")
        for recording, by_output in r.agreement.items()
        for name, by_mode in by_output.items()
        if (a := by_mode.get(STEADY)) is not None
    ]
    head = "| recording | output | RMS, steady | noise floor | ratio | with the inputs' noise |"
    table = "\n".join([head, "|---|---|---|---|---|---|", *steady])
    origin = f"Recordings: {'; '.join(r.sources)}.\n\n" if r.sources else ""
    return f"# Calibration of {r.model}{of}\n\n{origin}![Free run]({picture})\n\n{table}\n\n```\n{body}\n```\n"


def draw(told: Report, model: Model, runs: Mapping[str, Mapping[str, Validation]]) -> bytes:
    """The free runs as a PNG: for each recording (a column) its outputs, measured and predicted, and its inputs.

    `runs` are by recording and by the model's name.
    """
    mpl.use("Agg")
    first = next(iter(next(iter(runs.values())).values()))
    outputs = list(first.sections[0].samples)
    inputs = list(first.trajectories[0].system.inputs)
    units = units_of(model)
    figure = Figure(figsize=(8 * len(runs), 2.2 * len(outputs) + 2.6), layout="constrained")
    rows = [2.0] * len(outputs) + [1.3]
    grid = figure.subplots(len(rows), len(runs), sharex="col", squeeze=False, height_ratios=rows)
    for column, (recording, by_model) in enumerate(runs.items()):
        for axes, name in zip(grid[:, column], outputs, strict=False):
            _output(axes, name, units.of(model.known[name].unit, signal=name), by_model)
        _inputs(grid[-1, column], inputs, model, units, next(iter(by_model.values())))
        grid[0, column].set_title(recording, fontsize=11)
        grid[-1, column].set_xlabel("log time [s]")
    figure.suptitle(f"Free run on {' and '.join(inputs)} alone; {'; '.join(told.sources)}", fontsize=12)
    png = BytesIO()
    figure.savefig(png, format="png", dpi=100)
    return png.getvalue()


def _output(axes: Axes, name: str, shown: Display, by_model: Mapping[str, Validation]) -> None:
    measured = next(iter(by_model.values()))
    for k, section in enumerate(measured.sections):
        s = section.samples[name]
        label = "measured" if k == 0 else None
        axes.plot(section.start_s + s.t, shown.scaled(s.value), ".", color="#9db7d5", markersize=2, label=label)
    for (title, validation), style in zip(by_model.items(), STYLES, strict=False):
        for k, (section, trajectory) in enumerate(zip(validation.sections, validation.trajectories, strict=True)):
            label = title if k == 0 else None
            inside = section.t > section.samples[name].t[0]
            y = shown.scaled(trajectory.outputs()[name][inside])
            axes.plot(section.start_s + section.t[inside], y, label=label, **style)
    axes.set_ylabel(f"{name} [{shown.unit}]")
    axes.grid(visible=True, alpha=0.25)
    axes.margins(x=0)
    axes.legend(loc="upper left", ncols=3, fontsize=8)


def _inputs(axes: Axes, names: Sequence[str], model: Model, units: Units, validation: Validation) -> None:
    for k, (name, color) in enumerate(zip(names, ("#444444", "#6a4c93", "#2e7d32"), strict=False)):
        side, shown = axes if k == 0 else axes.twinx(), units.of(model.known[name].unit, signal=name)
        for section in validation.sections:
            side.plot(section.start_s + section.t, shown.scaled(section.drive.inputs[:, k]), color=color, linewidth=0.9)
        side.set_ylabel(f"{name} [{shown.unit}]", color=color)
    axes.grid(visible=True, alpha=0.25)
    axes.margins(x=0)
