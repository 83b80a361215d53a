"""The experiments of a system, `experiments.toml` beside its models: what can be recorded to tell effects apart.

schema = 1
[control]                how a plan runs the model in a closed loop; without it nothing is planned
actuator, follows, command, offset, gain, ramp   see `Control`
before_s, start          from a recording's start until its cycle begins [s]; the set point until then
longest_s                of a recording: experiments are joined to cycles no longer than this
unit, columns            of set points in this file; what the values of a segment are called in a cycle file
[gauge]                  "Pa" = 0.003: a unit that a workshop has a gauge for, precise to this part of the reading
[[experiment]]           name, text, segments = [[duration_s, set point, command], ...]  (absent: none can be planned)
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from faultline.analysis.model import ModelError
from faultline.analysis.model.tables import Table, first_repeated
from faultline.analysis.model.units import parse_unit

FILE = "experiments.toml"
SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class Control:
    """A plan sets `actuator` = offset + gain*(set point - `follows`), not below zero, and `command` as it says.

    The set point moves by `ramp` [1/s] at most, as it does in operation, from `start`, which it has for `before_s` [s]:
    standing still, starting, the model's warm-up. No recording takes longer than `longest_s` [s]. One `unit` of a cycle
    file, with these `columns`, is so much in SI.
    """

    actuator: str
    follows: str
    command: str
    offset: float
    gain: float
    ramp: float
    before_s: float
    longest_s: float
    start: float
    unit: float
    columns: tuple[str, ...]


@dataclass(frozen=True)
class Experiment:
    """A cycle: `segments` of duration [s], set point [unit of what follows it] and command."""

    name: str
    text: str
    segments: tuple[tuple[float, float, float], ...]
    control: Control

    @property
    def duration_s(self) -> float:
        """Return the duration of the recording [s], with what comes before the cycle."""
        return self.control.before_s + sum(duration for duration, _, _ in self.segments)

    def cycle(self) -> str:
        """Return the text of the cycle file."""
        head = f'schema = 1\nname = "{self.name.replace("_", "-")}"\ntext = "{self.text}"\n'
        rows = [(duration, set_point / self.control.unit, command) for duration, set_point, command in self.segments]
        parts = [
            "\n[[segment]]\n" + "".join(f"{n} = {v:g}\n" for n, v in zip(self.control.columns, row, strict=True))
            for row in rows
        ]
        return head + "".join(parts)


def joined(parts: Sequence[Experiment]) -> Experiment:
    """One experiment after the other, in one recording."""
    runs = [(part, len([*same])) for part, same in groupby(parts)]
    return Experiment(
        name="-".join(part.name if times == 1 else f"{part.name}-x{times}" for part, times in runs),
        text=", then ".join(part.text if times == 1 else f"{times} times {part.text}" for part, times in runs),
        segments=tuple(segment for part in parts for segment in part.segments),
        control=parts[0].control,
    )


@dataclass(frozen=True)
class Experiments:
    """All of a system in words, by name; those `planned`, which have a cycle; gauges' precision by unit."""

    texts: Mapping[str, str] = field(default_factory=dict)
    planned: tuple[Experiment, ...] = ()
    gauges: Mapping[str, float] = field(default_factory=dict)

    @property
    def unplanned(self) -> tuple[str, ...]:
        """Return the experiments without a cycle, which no model can plan."""
        planned = {experiment.name for experiment in self.planned}
        return tuple(name for name in self.texts if name not in planned)


NO_EXPERIMENTS = Experiments()


def load_experiments(system: Path | None) -> Experiments:
    """The experiments of the system in a folder; none where it has no such file.

    Raises:
        ModelError: the file is not valid.
    """
    file = None if system is None else system / FILE
    if file is None or not file.is_file():
        return NO_EXPERIMENTS
    try:
        top = Table(tomllib.loads(file.read_bytes().decode()), str(file), top=True)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ModelError(f"{file}: not read: {error}") from error
    if top.number("schema") != SCHEMA:
        raise top.fail("schema", f"readable is {SCHEMA}; use the faultline that wrote the file")
    written, gauges = top.table("control"), top.table("gauge")
    control = None if written is None else _control(written)
    texts, planned = {}, []
    tables = top.tables("experiment")
    names = [table.text("name") for table in tables]
    if (twice := first_repeated(names)) is not None:
        raise top.fail("experiment", f"two are named {twice}; rename one")
    for name, table in zip(names, tables, strict=True):
        texts[name], segments = table.text("text"), table.rows("segments")
        table.done()
        if segments:
            if control is None or any(len(row) != len(control.columns) for row in segments):
                raise table.fail("segments", "must be lists of duration_s, set point and command, with a [control]")
            cycle = tuple((duration, level * control.unit, command) for duration, level, command in segments)
            planned.append(Experiment(name, texts[name], cycle, control))
    precise = {} if gauges is None else gauges.rest()
    units = Table(precise, top.at("gauge"))
    top.done()
    return Experiments(texts, tuple(planned), {unit: units.number(unit) for unit in precise})


def _control(table: Table) -> Control:
    try:
        unit = float(parse_unit(table.text("unit"))[0])
    except ValueError as error:
        raise table.fail("unit", str(error)) from error
    control = Control(
        actuator=table.text("actuator"),
        follows=table.text("follows"),
        command=table.text("command"),
        offset=table.number("offset"),
        gain=table.number("gain"),
        ramp=table.number("ramp"),
        before_s=table.number("before_s"),
        longest_s=table.number("longest_s"),
        start=table.number("start") * unit,
        unit=unit,
        columns=table.texts("columns"),
    )
    table.done()
    if len(control.columns) != 3:
        raise table.fail("columns", "give three names: of the duration, the set point and the command")
    return control
