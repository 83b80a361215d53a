"""Test bench with two loggers, as `[bench]` in `system.toml` describes it; without the table a system has none.

[bench]                  signals: known ones of the model
reference, follower      pressures on the bus and of the second logger, which rise and fall together
drive, drive_above       what makes the system run, and the level from which it does
command                  what is asked of the actuator, pulsed with this duty cycle (0..1)
message                  of the DBC: the message that carries the second logger's signals
ambient = ["p_tank"]     parameters that are the ambient pressure  (may be absent)
drained_pa, ...          see `BenchSetup`
"""

import dataclasses
from collections.abc import Collection, Mapping

from faultline.analysis.model.tables import Table, first_repeated

ROLES = ("reference", "follower", "drive", "command")
PRESSURE = "Pa"


@dataclasses.dataclass(frozen=True, kw_only=True)
class BenchSetup:
    """Roles of signals on a test bench, and the levels that tell its states; `units` are by signal on the bus.

    At standstill `reference` is within `drained_pa` of the ambient pressure, and a sensor's readings scatter by less
    than `steady_pa`. A reading there is off by a zero error up to `zero_error_pa`; from `wrong_sensor_pa` on it is of
    another sensor, unit or table. The system is under pressure where `reference` is above `running_pa`; `follower`,
    upstream of it, is never lower by more than `uphill_pa`. A step of pressure is at least `step_pa` high, and
    `step_pa_per_s` steep. From no command to full command the drop between the two grows by at most `command_drop_pa`
    in a healthy system; a new command acts `command_delay_s` late, on average. Its pulses have a frequency within
    `pulse_hz`.
    """

    reference: str
    follower: str
    drive: str
    drive_above: float
    command: str
    message: str
    ambient: tuple[str, ...]
    drained_pa: float
    steady_pa: float
    zero_error_pa: float
    wrong_sensor_pa: float
    running_pa: float
    uphill_pa: float
    step_pa: float
    step_pa_per_s: float
    command_drop_pa: float
    command_delay_s: float
    pulse_hz: tuple[float, float]
    units: Mapping[str, str]

    @property
    def written(self) -> dict[str, object]:
        """The table as it stands in a file."""
        return {key: value for key, value in vars(self).items() if key != "units"}


def bench_of(top: Table, units: Mapping[str, str], parameters: Collection[str]) -> BenchSetup | None:
    """The bench in the tables of a model with known signals of these `units`; None if it has none.

    Raises:
        ModelError: it is not valid.
    """
    table = top.table("bench")
    if table is None:
        return None
    reference, follower, drive, command = _roles(table, units)
    found = BenchSetup(
        reference=reference,
        follower=follower,
        drive=drive,
        drive_above=_positive(table, "drive_above"),
        command=command,
        message=table.text("message"),
        ambient=table.texts("ambient"),
        drained_pa=_positive(table, "drained_pa"),
        steady_pa=_positive(table, "steady_pa"),
        zero_error_pa=_positive(table, "zero_error_pa"),
        wrong_sensor_pa=_positive(table, "wrong_sensor_pa"),
        running_pa=_positive(table, "running_pa"),
        uphill_pa=_positive(table, "uphill_pa"),
        step_pa=_positive(table, "step_pa"),
        step_pa_per_s=_positive(table, "step_pa_per_s"),
        command_drop_pa=_positive(table, "command_drop_pa"),
        command_delay_s=_positive(table, "command_delay_s"),
        pulse_hz=_band(table, "pulse_hz"),
        units={name: units[name] for name in (reference, drive, command)},
    )
    table.done()
    for name in found.ambient:
        if name not in parameters:
            raise table.fail("ambient", f"{name} is no parameter; those are {', '.join(parameters)}")
    return found


def _roles(table: Table, units: Mapping[str, str]) -> list[str]:
    """The signals of `ROLES`, each another one."""
    signals = [table.text(role) for role in ROLES]
    for role, signal in zip(ROLES, signals, strict=True):
        if signal not in units:
            raise table.fail(role, f"{signal} is no known signal; those are {', '.join(units)}")
        if role in ("reference", "follower") and units[signal] != PRESSURE:
            raise table.fail(role, f"{signal} is in {units[signal]}; the clocks are aligned by pressures in {PRESSURE}")
    if (twice := first_repeated(signals)) is not None:
        raise table.fail("reference", f"{twice} has two of the roles {', '.join(ROLES)}; give each a signal of its own")
    return signals


def _positive(table: Table, key: str) -> float:
    if (value := table.number(key)) <= 0:
        raise table.fail(key, f"{value:g}; give a positive number")
    return value


def _band(table: Table, key: str) -> tuple[float, float]:
    match table.numbers(key):
        case (low, high) if 0 < low < high:
            return low, high
    raise table.fail(key, "give the lowest and the highest frequency, as in [1.0, 9.0]")


def of_variant(bench: object, signals: Collection[str], parameters: Collection[str]) -> dict[str, object]:
    """The system's bench as a further model of it has it: none without a role's signal, and its own parameters alone.

    Such a model may have fewer sensors, or a barometer instead of a constant.
    """
    table = bench if isinstance(bench, dict) else {}
    if any(isinstance(role := table.get(name), str) and role not in signals for name in ROLES):
        return {}
    ambient = table.get("ambient")
    own = {"ambient": [name for name in ambient if name in parameters]} if isinstance(ambient, list) else {}
    return {"bench": {**table, **own}} if table else {}
