"""Checks of path and query: unknown or invalid parameters are refused by name."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from starlette.datastructures import QueryParams
from starlette.requests import Request

from faultline.service.web.faults import AGGREGATED, STATUS_KEYS
from faultline.service.web.problems import RequestError

SYSTEM = r"^[^\x00-\x1f\x7f/]{1,200}$"
CODE = r"^[1-9][0-9]{0,8}$"
ID = r"^[!-~]{1,200}$"
SCOPE = r"^[A-Za-z0-9_.-]{1,80}$"
LARGEST = 2**53 - 1  # of a number that every JSON reader keeps
MOST_TICKS = 5000  # in an answer of a recording
MOST = 500  # records in an answer of the daemon

BOOLEANS = {"true": True, "false": False, "1": True, "0": False}


class Filter(NamedTuple):
    """Filter of faults: any of these values of the status, by key; severity and scope. None and empty: all."""

    status: Mapping[str, frozenset[str]]
    severity: int | None
    scope: str | None


class Page(NamedTuple):
    """At most `most` records: the first `after` a number, the last `before` one, the first between both; the latest."""

    most: int
    after: int | None
    before: int | None


class Part(NamedTuple):
    """The ticks `after` one and `before` another (None: from the first, to the last), no more than `most`."""

    after: int | None
    before: int | None
    most: int | None


def system_of(request: Request) -> str:
    """Return the system in the path."""
    return _matching(SYSTEM, request.path_params["system"], "system")


def number_of(request: Request) -> int:
    """Return the fault's number in the path."""
    return int(_matching(CODE, request.path_params["code"], "code"))


def filter_of(query: QueryParams) -> Filter:
    """Return the filter in the query of a list of faults."""
    _known(query, ["severity", "scope", *(f"status[{key}]" for key in _KEYS.values())], folded=True)
    status: dict[str, set[str]] = {}
    for name, value in query.multi_items():
        if (key := _status_key(name)) is not None:
            status.setdefault(key, set()).add(_status_value(name, key, value))
    scope = query.get("scope")
    return Filter(
        {key: frozenset(values) for key, values in status.items()},
        _number(query, "severity", 1, 4),
        None if scope is None else _matching(SCOPE, scope, "scope"),
    )


def parts_of(query: QueryParams) -> tuple[bool, bool]:
    """Return whether extended data, and snapshots, are requested with a fault."""
    names = ["include-extended-data", "include-snapshot-data"]
    _known(query, names)
    extended, snapshots = (_boolean(name, query.get(name, "true")) for name in names)
    return extended, snapshots


def place_of(request: Request) -> int | str | None:
    """Return the record after which a stream begins: the client's last id, else that of the query; None for now."""
    _known(request.query_params, ["after"])
    last = request.headers.get("last-event-id", "")
    if last:
        return _matching(ID, last, "Last-Event-ID")
    after = request.query_params.get("after")
    if after is None:
        return None
    return _number(request.query_params, "after", 0, LARGEST) if after.isdecimal() else _matching(ID, after, "after")


def page_of(query: QueryParams) -> Page:
    """Return the records that are requested."""
    _known(query, ["after", "before", "count"])
    count = _number(query, "count", 1, MOST)
    after, before = (_number(query, name, 0, LARGEST) for name in ("after", "before"))
    return Page(100 if count is None else count, after, before)


def part_of(query: QueryParams) -> Part:
    """Return the ticks of a recording that are requested."""
    _known(query, ["after", "before", "count"])
    after, before = (_number(query, name, 0, LARGEST) for name in ("after", "before"))
    return Part(after, before, _number(query, "count", 1, MOST_TICKS))


def nothing_in(query: QueryParams) -> None:
    """Refuse any query."""
    _known(query, [])


_KEYS = {key.lower(): key for key in (*STATUS_KEYS, "aggregatedStatus")}


def _status_key(name: str) -> str | None:
    match = re.fullmatch(r"status\[(\w+)\]", name)
    return _KEYS.get(match[1].lower()) if match else None


def _status_value(name: str, key: str, value: str) -> str:
    if key == "aggregatedStatus":
        if value not in AGGREGATED:
            raise RequestError(400, "bad-query", f"{name}: one of {', '.join(AGGREGATED)}")
        return value
    return "1" if _boolean(name, value) else "0"


def _known(query: QueryParams, names: Sequence[str], *, folded: bool = False) -> None:
    """Refuse what is not among `names` (in any case if `folded`), and what is there twice but a status."""
    allowed = {name.lower() for name in names} if folded else set(names)
    given = [name for name, _ in query.multi_items()]
    for name in given:
        if (name.lower() if folded and name.startswith("status[") else name) not in allowed:
            can = f"those are {', '.join(names)}" if names else "this takes none"
            raise RequestError(400, "bad-query", f"no query parameter {name[:80]!r}; {can}")
        if given.count(name) > 1 and not name.startswith("status["):
            raise RequestError(400, "bad-query", f"{name}: given more than once")


def _number(query: QueryParams, name: str, least: int, most: int) -> int | None:
    value = query.get(name)
    if value is None:
        return None
    if not re.fullmatch(r"[0-9]{1,16}", value) or not least <= int(value) <= most:
        raise RequestError(400, "bad-query", f"{name}: a whole number from {least} to {most}")
    return int(value)


def _boolean(name: str, value: str) -> bool:
    if value not in BOOLEANS:
        raise RequestError(400, "bad-query", f"{name}: true or false")
    return BOOLEANS[value]


def _matching(pattern: str, value: str, name: str) -> str:
    if not re.fullmatch(pattern.removeprefix("^").removesuffix("$"), value):
        raise RequestError(400, "bad-request", f"{name}: must match {pattern}")
    return value
