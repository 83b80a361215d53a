"""Reads candump's text logs and salvages: a bad line costs that line, never what follows it.

A line is `(1767225600.123456) can0 18FF103D#0011223344556677`; 3 digits of identifier are an 11-bit frame, 8 are a
29-bit one; `##F` with flags F before the data is CAN FD. Source of the format: can-utils, `candump -L`, lib.c.
"""

import re
from binascii import unhexlify
from collections.abc import Iterator

from faultline.service.logs.report import Frame, LogReport, OnChannel, shown

EXAMPLE = "(1767225600.123456) can0 18FF103D#0011223344556677"

_CLASSIC = re.compile(
    rb"\((\d+\.\d+)\) +(\S+) +([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#([0-9A-Fa-f]{0,16})(?:_[0-9A-Fa-f])?(?: [RT])?\s*"
)
_FD = re.compile(
    rb"\((\d+\.\d+)\) +(\S+) +([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})##[0-9A-Fa-f]([0-9A-Fa-f]{0,128})(?: [RT])?\s*"
)
_REMOTE = re.compile(rb"\(\d+\.\d+\) +\S+ +(?:[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#R[0-9A-Fa-f]*(?: [RT])?\s*")
_STAMP = re.compile(rb"\(\d+\.\d+\) +\S+ +")

_FD_SIZES = frozenset([*range(9), 12, 16, 20, 24, 32, 48, 64])  # bytes, ISO 11898-1
_ERROR_FLAG = 0x2000_0000
_EXTENDED_TOP = 0x1FFF_FFFF


def read_candump(content: bytes, report: LogReport) -> Iterator[OnChannel]:
    """The data frames of a log in the file's order.

    A last line without its newline is not used, whatever it holds: nothing in a line says how long the data is.
    """
    lines = content.split(b"\n")
    report.truncated = bool(lines.pop())
    for number, line in enumerate(lines, start=1):
        match = _CLASSIC.fullmatch(line)
        if match is None or len(match[4]) % 2:  # half a byte is no data
            found = _other(number, line, report)
            if found is not None:
                yield found
            continue
        stamp, channel, identifier, data = match.groups()
        frame = Frame(float(stamp), int(identifier, 16), len(identifier) == 8, unhexlify(data))
        if frame.can_id > _EXTENDED_TOP:
            _flagged(number, frame, report)
        else:
            yield channel, frame


def _other(number: int, line: bytes, report: LogReport) -> OnChannel | None:
    """Return the frame of a line that is no classic data frame: CAN FD; else count it for what it is."""
    match = _FD.fullmatch(line)
    if match is not None:
        stamp, channel, identifier, data = match.groups()
        if len(data) / 2 in _FD_SIZES and int(identifier, 16) <= _EXTENDED_TOP:
            return channel, Frame(float(stamp), int(identifier, 16), len(identifier) == 8, unhexlify(data))
        report.reject(number, f"no CAN FD frame has {len(data) / 2:g} bytes under identifier {identifier.decode()}")
    elif _REMOTE.fullmatch(line):
        report.remote += 1
    elif line.strip():
        after_time = "no frame after the time in" if _STAMP.match(line) else "no candump line:"
        report.reject(number, f"{after_time} {shown(line)}")
    return None


def _flagged(number: int, frame: Frame, report: LogReport) -> None:
    if frame.can_id & _ERROR_FLAG:
        report.errors += 1
    else:
        report.reject(number, f"identifier {frame.can_id:08X} has more than 29 bits")


def no_candump(content: bytes, report: LogReport) -> str:
    """Return why a file without a frame is no log of this format, and what one looks like."""
    remedy = f"a candump line looks like `{EXAMPLE}`"
    if not content.strip():
        return f"is empty; {remedy}"
    if report.told:
        number, reason = report.told[0]
        return f"line {number}: not a CAN log, {reason}; {remedy}"
    if report.truncated and not (report.remote or report.errors):
        return f"line 1: its only line is cut off; {remedy}"
    return f"holds no data frame; {remedy}"
