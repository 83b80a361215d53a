"""The configuration of `faultline j1939`: a TOML file, strict; `service/vehicle/j1939.toml` has all its keys."""

from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.j1939.claim import CONTENDED
from faultline.service.j1939.name import name_of
from faultline.service.strict import ControlSocket, EventsSocket, Part, Read, read

_BUS = r"\A(socketcan:[^\s/:]{1,15}|udp_multicast:\d+\.\d+\.\d+\.\d+:\d+)\Z"
_BUSES = "socketcan:NAME (as socketcan:can0), or udp_multicast:GROUP:PORT for trials"
Interface = Annotated[str, Meta(pattern=_BUS, description=_BUSES)]
Address = Annotated[int, Meta(ge=0, le=253, description="addresses from 0 to 253, the preferred one first")]


class NameConfig(Part, frozen=True):
    """The fields of the NAME, in the widths that they have there."""

    identity_number: Annotated[int, Meta(ge=0, le=0x1F_FFFF, description="the number of this device, no other one's")]
    manufacturer_code: Annotated[int, Meta(ge=0, le=0x7FF, description="the code assigned by SAE, 0 to 2047")]
    function: Annotated[int, Meta(ge=0, le=0xFF, description="what the device is for, of SAE's list, 0 to 255")]
    ecu_instance: Annotated[int, Meta(ge=0, le=7)] = 0
    function_instance: Annotated[int, Meta(ge=0, le=31)] = 0
    vehicle_system: Annotated[int, Meta(ge=0, le=127)] = 0
    vehicle_system_instance: Annotated[int, Meta(ge=0, le=15)] = 0
    industry_group: Annotated[int, Meta(ge=0, le=7)] = 0
    arbitrary_address_capable: bool = False

    @property
    def value(self) -> int:
        """Return the NAME."""
        return name_of(**{key: int(value) for key, value in msgspec.structs.asdict(self).items()})


class J1939Config(Part, frozen=True):
    """The table `[j1939]`."""

    interface: Interface
    control: ControlSocket
    events: EventsSocket
    addresses: Annotated[list[Address], Meta(min_length=1, max_length=120, description="the addresses to claim")]
    name: NameConfig
    transmit: bool = False


class _File(Part, frozen=True):
    j1939: J1939Config


def load_config(path: Path) -> J1939Config:
    """Return the configuration in the file at `path`, if it allows to transmit; else raises ConfigError, as `read`."""
    file = read(path, _File)
    _check(file)
    return file.said.j1939


def _check(file: Read[_File]) -> None:
    """Check the fields against each other."""
    config = file.said.j1939
    addresses = config.addresses
    if len(addresses) > 1 and not config.name.arbitrary_address_capable:
        message = "a NAME that is not arbitrary_address_capable has one address; leave the others out, or set it"
        raise file.wrong(["j1939", "addresses"], message)
    for k, address in enumerate(addresses):
        if addresses.index(address) != k:
            raise file.wrong(["j1939", "addresses", k], f"{address} is there twice; remove one")
        if k and address not in CONTENDED:
            message = f"{address} is assigned to a function; after the preferred address only 128 to 247"
            raise file.wrong(["j1939", "addresses", k], message)
    if not config.transmit:
        message = "transmitting is off: set transmit = true here if this device may send on the vehicle's bus"
        raise file.wrong(["j1939", "transmit"], message)
