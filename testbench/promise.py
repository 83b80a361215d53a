"""What the demo records, and what it promises of it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Verdict:
    """What `evaluate --json` says of a recording."""

    recording: str
    faults: list[str]
    onset_s: float | None
    detected: bool
    delay_s: float | None
    isolated: list[str]
    first: list[str]
    contained: bool
    named: bool
    tests: list[str]
    false_alarms: int
    could_tell: dict[str, float]
    blind: list[str]
    apart_ticks: int | None


@dataclass(frozen=True)
class Recording:
    """One run of the rig: what for, and the arguments of `rig record`."""

    purpose: str
    cycle: str
    seed: int
    duration: float
    fault: str = ""
    size: float = 0.0

    @property
    def name(self) -> str:
        """Its id."""
        return f"{self.cycle}-{self.seed}" + (f"-{self.fault}" if self.fault else "")

    @property
    def arguments(self) -> list[str]:
        """Those of `rig record`, without the folders."""
        given = ["--id", self.name, "--cycle", self.cycle, "--seed", str(self.seed), "--duration", str(self.duration)]
        return [*given, "--fault", self.fault, "--size", str(self.size), "--onset", "150"] if self.fault else given


RECORDINGS = (
    Recording("calibrate", "training", 1, 480),
    Recording("tune", "drive", 2, 420),
    Recording("tune", "drive", 3, 420),
    Recording("tune", "training", 4, 420),
    Recording("evaluate", "validation", 5, 420),
    Recording("evaluate", "validation", 6, 420, "fA_du", 0.65),
    Recording("evaluate", "validation", 7, 420, "fA_t", 0.65),
)

ALLOWED = {
    "fA_du": {"fA_du", "fy_p_du", "fy_p_ap"},
    "fA_t": {"fA_t", "fA_p", "fq_pump", "fy_p_tp"},
}
"""What integral-causality tests can leave at most as explanation of each fault (thesis fig. 5.5b and the test set)."""

FIRST = {"fA_du"}
"""Faults that must be ranked first, and alone, by sign, size and pattern."""

COULD_TELL = 0.8
"""Share of an evaluated recording in which each test must have been able to tell: else silence would prove nothing."""


def sentence(v: Verdict) -> str:
    """The verdict in a line."""
    if not v.faults:
        return f"fault-free: {v.false_alarms} false alarms"
    return (
        f"{v.faults[0]} from {v.onset_s:g} s: detected after {v.delay_s} s, isolated {{{', '.join(v.isolated)}}}, "
        f"first {', '.join(v.first)}, {v.false_alarms} false alarms before, {_live(v)}"
    )


def _live(v: Verdict) -> str:
    if v.apart_ticks is None:
        return "over the bus other candidates than offline"
    return f"over the bus within {v.apart_ticks} samples of offline"


def problems(v: Verdict) -> list[str]:
    """What is not as the demo promises."""
    found = [f"{v.false_alarms} false alarms"] if v.false_alarms else []
    found += [
        f"{test} could tell in {100 * share:.0f} % of it only"
        for test, share in v.could_tell.items()
        if share < COULD_TELL
    ]
    if not v.faults:
        return found
    [fault] = v.faults
    if not v.detected:
        found.append("not detected")
    elif fault not in v.isolated or not set(v.isolated) <= ALLOWED[fault]:
        found.append(f"the isolated set should hold {fault} and at most {', '.join(sorted(ALLOWED[fault]))}")
    elif fault in FIRST and v.first != [fault]:
        found.append(f"{fault} should be ranked first, alone")
    return found
