"""The manifest that a tuning makes of a model: what export writes, and what tuning itself tries on drives left out."""

import hashlib
from collections.abc import Mapping, Sequence

import msgspec
from msgspec import structs

from faultline.analysis.calibration.provenance import recordings_of, vehicle_of
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import Model
from faultline.analysis.model.display import units_of
from faultline.analysis.tuning.file import Tuning
from faultline.service.core.manifest import SCHEMA, Disturbance, Equation, Fault, File, Input, Manifest, Origin, Unit
from faultline.service.core.signals.dbc import NO_BUSES, NOBODY, OWN_NAMES

GOLDEN = "golden.json"


def manifest_of(
    runnable: Runnable,
    tuning: Tuning,
    files: Mapping[str, bytes],
    dbc_name: str | None,
    version: int = 0,
    senders: Mapping[str, int] = NOBODY,
    buses: Mapping[str, str] = NO_BUSES,
    signals: Mapping[str, str] = OWN_NAMES,
    units: Sequence[Unit] = (),
) -> Manifest:
    """Return the manifest; `files` are the others of the bundle, `senders` and `buses` those of messages, by name.

    `signals` are the DBC's names of the model's signals, `units` those of its units that the vehicle does not know.
    """
    bank = runnable.bank
    return Manifest(
        schema=SCHEMA,
        name=bank.model.name,
        version=version,
        sensor_set=bank.model.sensor_set,
        period_s=bank.model.period_s,
        settling_s=bank.model.settling_s,
        start_within_s=tuning.start_within_s,
        dbc=dbc_name,
        graphs=runnable.files,
        golden=GOLDEN,
        files={name: File(sha256=hashlib.sha256(raw).hexdigest(), size=len(raw)) for name, raw in files.items()},
        origin=Origin(
            model=bank.model.name,
            model_sha256=tuning.model_sha256,
            calibrate=list(dict.fromkeys([*recordings_of(bank.model), *tuning.calibrated])),
            train=runnable.trained_on,
            tune=tuning.recordings,
            base=tuning.base,
            vehicle=vehicle_of(bank.model),
        ),
        inputs=_inputs(bank.model, tuning.inputs),
        generators=list(runnable.generators),
        modes=tuning.modes,
        detectors=tuning.detectors,
        faults=[msgspec.convert(fault, Fault, from_attributes=True) for fault in bank.model.faults.values()],
        disturbances=[
            Disturbance(name=e.disturbance.name, equation=e.name, description=e.disturbance.description)
            for e in bank.model.equations.values()
            if e.disturbance is not None
        ],
        equations=_equations(runnable),
        evidence=tuning.evidence,
        claim=tuning.claim,
        senders=dict(senders),
        buses=dict(buses),
        signals={each.signal: signals[each.signal] for each in tuning.inputs if each.signal in signals},
        units=list(units),
    )


def _inputs(model: Model, tuned: Sequence[Input]) -> list[Input]:
    """The inputs with the names and units that people read."""
    units = units_of(model).by
    labels = {name: known.label or known.description for name, known in model.known.items()}
    return [structs.replace(one, label=labels[one.signal], display=list(units[one.signal])) for one in tuned]


def _equations(runnable: Runnable) -> list[Equation]:
    """Those that generators use, or that may be disturbed, in the model's order."""
    model = runnable.bank.model
    described = {name: equation.description for name, equation in model.equations.items()}
    described |= {d.name: f"{d.derivative} is the derivative of {d.state}" for d in model.differentials}
    used = {name for generator in runnable.generators for name in generator.equations}
    used |= {name for name, equation in model.equations.items() if equation.disturbance is not None}
    return [Equation(name=name, description=text) for name, text in described.items() if name in used]
