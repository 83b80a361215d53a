"""What a discovery found, for programs: `discovery.json`, from which page, summary and terminal are written too.

All values are in the model's units, evidences in nats; what is not known is null. Nothing of when or where it was
computed is in it: the same recordings, model and library give the same document.
"""

from collections.abc import Mapping
from typing import Any

import msgspec

from faultline.analysis.discrepancy.discover import Kind
from faultline.analysis.model.display import Units
from faultline.service.logs.recording import is_simulated

SCHEMA = "faultline.discovery/1"


class Candidate(msgspec.Struct, frozen=True, kw_only=True):
    """An effect that the data ask for: its entry of the library, or one that they cannot tell from it."""

    name: str
    statement: str
    component: str
    separated_by: tuple[str, ...]


class Place(msgspec.Struct, frozen=True, kw_only=True):
    """One effect of the model that was chosen: its `candidates`, the chosen one first, and the evidence it brings."""

    candidates: tuple[Candidate, ...]
    gain: float


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """`kind` is *nothing missing*, *named*, *one of*, *unnamed* or *recordings differ*; `sentence` says it in words.

    Of an unnamed one, `places` are the effects that come nearest: what is left with them is `remainder`. Chance alone
    brings less than `threshold` in 99 of 100 cases.
    """

    kind: Kind
    sentence: str
    places: tuple[Place, ...]
    gain: float
    remainder: float
    threshold: float


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """Log probabilities of the data, up to a constant, with the model as it was and with the effects in it.

    `dispersion` is the mean square of what is left, in the noise's: about one or less if nothing but noise is.
    """

    training_before: float
    training_after: float
    held_out_before: float
    held_out_after: float
    dispersion_before: float
    dispersion_after: float


class Strength(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter of an effect; `interval` (95 %) is null at a bound, `no_effect` is its value without the effect.

    An end of the interval is null where the recordings do not bound it.
    """

    effect: str
    parameter: str
    description: str
    unit: str
    value: float
    interval: tuple[float | None, float | None] | None
    no_effect: float | None
    words: str


class Part(msgspec.Struct, frozen=True, kw_only=True):
    """What an equation misses: a `value` with its standard deviation, a fraction of a term's size, and in words."""

    equation: str
    words: str
    value: float
    sd: float


class Course(msgspec.Struct, frozen=True, kw_only=True):
    """An equation's unknown input over the training recordings' log time, in cells of some seconds.

    `value` and `sd` are an amount of `variable`; divided by `size`, a fraction of it.
    """

    equation: str
    variable: str
    unit: str
    size: float
    t_s: tuple[float, ...]
    value: tuple[float, ...]
    sd: tuple[float, ...]


class Located(msgspec.Struct, frozen=True, kw_only=True):
    """Where something is missing: the class of equations that do the same, and those that no recording tells apart.

    `descriptions` are the equations' own, by name. Each of `sensors`, if it were measured, would tell more.
    """

    sentences: tuple[str, ...]
    equations: tuple[str, ...]
    descriptions: dict[str, str]
    inseparable: tuple[str, ...]
    sensors: tuple[str, ...]
    parts: tuple[Part, ...]
    course: Course | None


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """An entry of the library, alone in the model: by how much it is better than the model as it was.

    The gains are null where a few steps of the fit showed that others do more, or where the entry has `no_place` in
    this model. `best` are its parameters where it was best. It was searched from so many `starts` and, if these settled
    nothing, globally over so many `sizes`; `promised` [nats] is the most that was in sight. `against` says in sentences
    what speaks against it. `smallest` is the size from which these recordings would show it, null if no possible one
    is; `alike` are entries that do the same in these recordings; `halted` says why its model could not be run from
    everywhere. `own` is a user's entry.
    """

    name: str
    statement: str
    gain: float | None
    gain_training: float | None
    gain_held_out: float | None
    smallest: float | None
    unit: str
    alike: tuple[str, ...]
    no_place: str | None
    halted: str | None = None
    own: bool = False
    against: tuple[str, ...] = ()
    best: tuple[Strength, ...] = ()
    promised: float = 0.0
    starts: int = 0
    sizes: int = 0


class White(msgspec.Struct, frozen=True, kw_only=True):
    """Of what is left: correlation of neighbouring seconds, and the probability (Ljung, Box) of more in noise."""

    lag1: float
    probability: float


class Regime(msgspec.Struct, frozen=True, kw_only=True):
    """The held-out free run's error of one output in one operating mode (*steady*: all but *edge*), in its unit.

    `expected` is the `floor` with what the inputs' noise makes of a free run; `closure` is the part of the gap above it
    that is closed, null where there was none.
    """

    output: str
    unit: str
    mode: str
    samples: int
    rms_before: float
    rms_after: float
    bias_before: float
    bias_after: float
    floor: float | None
    expected: float | None
    closure: float | None
    white_before: White | None
    white_after: White | None


class Zero(msgspec.Struct, frozen=True, kw_only=True):
    """A sensor's zero error in a held-out recording, in parts of its standard deviation: it, too, can hide a gap."""

    recording: str
    output: str
    before: float
    after: float


class Drift(msgspec.Struct, frozen=True, kw_only=True):
    """A parameter as the datasheet has it and fitted; distances are in standard deviations of the prior."""

    name: str
    description: str
    unit: str
    datasheet: float
    before: float
    after: float
    distance_before: float
    distance_after: float


class Section(msgspec.Struct, frozen=True, kw_only=True):
    """Something else that was found out, in `sentences` and for programs."""

    sentences: tuple[str, ...]
    data: Mapping[str, Any] = {}


class Term(msgspec.Struct, frozen=True, kw_only=True):
    """A term that is proposed: an entry by `name`, and its `equation` (= 0) as it is and with the term."""

    name: str
    equation: str
    statement: str
    before: str
    after: str


class Proposal(msgspec.Struct, frozen=True, kw_only=True):
    """A formula for what has no name: `terms`, each an entry of `proposal.toml`, and `rivals` that do as well there.

    Gains are evidences [nats], `remainder` that of an unknown input with the terms in, if it is known. `against` says
    in sentences what speaks against it. `tried` terms were composed.
    """

    sentence: str
    terms: tuple[Term, ...]
    rivals: tuple[Term, ...]
    strengths: tuple[Strength, ...]
    gain: float
    gain_training: float
    gain_held_out: float
    threshold: float
    remainder: float | None
    regimes: tuple[Regime, ...]
    against: tuple[str, ...]
    tried: int


class Origin(msgspec.Struct, frozen=True, kw_only=True):
    """Where the recordings are from; `missing` says in sentences what they lack, `without` what was not looked for.

    With `same_conditions` the user says that nothing changed from one recording to the next.
    """

    training: tuple[str, ...]
    held_out: tuple[str, ...]
    sources: tuple[str, ...]
    vehicle: str | None = None
    missing: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    same_conditions: bool = False

    @property
    def simulated(self) -> bool:
        """True if there are recordings and every one says that it is."""
        return bool(self.sources) and all(map(is_simulated, self.sources))


class Document(msgspec.Struct, frozen=True, kw_only=True):
    """All of it; `units` are those that people read.

    `experiments` are the system's in words, `unplanned` those without a plan. `drifts` and what follows are
    null where they were not asked for.

    `located` is where the model as it was misses something, `left` where that with the effects still does. `onset` is
    there if something set in while it was recorded: a fault rather than a missing effect. `proposal` is a formula for
    what has no name, not added to any model. `refused` are reasons why the
    effects should not be added to the model, `applied` tells that a model with them was written.
    """

    schema: str = SCHEMA
    model: str
    origin: Origin
    simulated: bool
    units: Units = Units()
    verdict: Verdict
    evidence: Evidence
    strengths: tuple[Strength, ...]
    located: Located
    left: Located
    regimes: tuple[Regime, ...]
    zeros: tuple[Zero, ...]
    entries: tuple[Entry, ...]
    drifts: tuple[Drift, ...] | None = None
    drift: Section | None = None
    structure: Section | None = None
    bundle: Section | None = None
    experiments: dict[str, str] = {}
    unplanned: tuple[str, ...] = ()
    experiment: Section | None = None
    gauge: Section | None = None
    proposal: Proposal | None = None
    onset: Section | None = None
    refused: tuple[str, ...] = ()
    applied: bool = False

    @property
    def named(self) -> bool:
        """Whether what is missing has a name, or one of several."""
        return self.verdict.kind in {"named", "one of"} and self.onset is None


def nats(value: float) -> str:
    """An amount of evidence in words: "0.0006 nats", "3.1 nats", "523 nats"."""
    return f"{value:.0f} nats" if value >= 10.0 else f"{value:.2g} nats"


def encoded(document: Document) -> bytes:
    """As a file."""
    return msgspec.json.format(msgspec.json.encode(document)) + b"\n"
