"""The NAME of a controller application, SAE J1939-81: 64 bits that no other on the bus has; the lower one wins."""

from zlib import crc32

FIELDS: tuple[tuple[str, int], ...] = (
    ("identity_number", 21),
    ("manufacturer_code", 11),
    ("ecu_instance", 3),
    ("function_instance", 5),
    ("function", 8),
    ("reserved", 1),
    ("vehicle_system", 7),
    ("vehicle_system_instance", 4),
    ("industry_group", 3),
    ("arbitrary_address_capable", 1),
)
"""Fields and their bits, the lowest first."""

SIZE = 8  # bytes, the lowest first
_ARBITRARY = 1 << 63
_STEP_S, _STEPS = 0.0006, 256


def name_of(**fields: int) -> int:
    """Return the NAME of these fields; those left out are 0.

    Raises:
        ValueError: no such field, or a value that does not fit.

    >>> f"{name_of(identity_number=1, manufacturer_code=2, function=3, arbitrary_address_capable=1):016X}"
    '8000030000400001'
    """
    if unknown := fields.keys() - {name for name, _ in FIELDS}:
        raise ValueError(f"no field of a NAME: {', '.join(sorted(unknown))}")
    name = shift = 0
    for field, bits in FIELDS:
        value = fields.get(field, 0)
        if not 0 <= value < 1 << bits:
            raise ValueError(f"{field} {value} does not fit in {bits} bits")
        name |= value << shift
        shift += bits
    return name


def is_arbitrary(name: int) -> bool:
    """Return True if a node of this NAME may take another address than its preferred one."""
    return bool(name & _ARBITRARY)


def delay_s(name: int, time: int) -> float:
    """Return the delay before the `time`th message that no address can be claimed: 0 to 153 ms.

    All who say so use the same identifier: two that begin at one moment disturb each other. So the delay looks random,
    of steps of 0.6 ms, and is another one each time; it comes from the NAME alone, so that nothing here is random.
    """
    return crc32(name.to_bytes(SIZE, "little") + time.to_bytes(4, "little")) % _STEPS * _STEP_S
