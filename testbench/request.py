"""What is asked of the rig: which vehicle, with what wrong, over which cycle, seen how."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from faultline.testbench.cycles import Cycle, check_duration
from faultline.testbench.day import CALM, Day
from faultline.testbench.effects import PROFILES, checked
from faultline.testbench.errors import RigError
from faultline.testbench.faults import Fault
from faultline.testbench.second_logger import SecondLogger
from faultline.testbench.vehicles import Vehicle

Kind = Literal["bench", "instrumented", "production"]
"""A bench has the added sensors on a second logger, an instrumented vehicle on the bus, a production one nowhere."""


@dataclass(frozen=True)
class Request:
    """What to record: `duration` [s]; `name` is the recording's id, `effects` are the hidden ones with their sizes.

    `format` is that of the CAN log, one of `FORMATS`; `logger` is the second logger, which only a bench has; `day` is
    what differs from one drive to the next.

    Raises:
        RigError: the duration is too short for a cycle, a fault comes twice or sets in after it, an effect is unknown
            or has an impossible size.
    """

    name: str
    vehicle: Vehicle
    cycle: Cycle
    faults: tuple[Fault, ...]
    seed: int
    duration: float
    effects: Mapping[str, float] = field(default_factory=lambda: PROFILES["realistic"])
    format: str = "log"
    kind: Kind = "bench"
    logger: SecondLogger = field(default_factory=SecondLogger)
    day: Day = CALM

    def __post_init__(self) -> None:
        if self.kind != "bench" and self.logger != SecondLogger():
            raise RigError(f"a vehicle of kind {self.kind} has no second logger to set; use --kind bench")
        check_duration(self.duration)
        checked(self.effects)
        names = [fault.name for fault in self.faults]
        for name in names:
            if names.count(name) > 1:
                raise RigError(f"fault {name} comes twice; give it once, with the size it is to have")
        for fault in self.faults:
            if not 0 <= fault.onset_s < self.duration:
                raise RigError(
                    f"onset {fault.onset_s:g} s of {fault.name} is not within the recording's {self.duration:g} s"
                )


def default_name(vehicle: str, cycle: str, seed: int, faults: Sequence[str]) -> str:
    """The recording's id, such as `bench-validation-s3-fA_du`."""
    return "-".join([vehicle, cycle, f"s{seed}", *faults])
