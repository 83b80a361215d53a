"""Dates in the cells of a table.

ISO 8601, 31.1.2026 12:00:00,5, 2026/1/31 12:00:00, and with slashes and the year last 31/1/2026 or 1/31/2026: which of
both a table has is seen over all its rows. Without a zone they are UTC. The time of a day alone counts from midnight.
"""

import re
from collections.abc import Iterable
from datetime import UTC, date, datetime
from datetime import time as day_time

_DATE = re.compile(
    r"(?:(?P<day>\d{1,2})\.(?P<month>\d{1,2})\.(?P<year>\d{4})"
    r"|(?P<y>\d{4})/(?P<m>\d{1,2})/(?P<d>\d{1,2})"
    r"|(?P<one>\d{1,2})/(?P<two>\d{1,2})/(?P<last>\d{4}))"
    r"(?:[ T]+(?P<rest>\d.+))?"
)
_HALF_DAY = re.compile(r"(\d{1,2})(:\d\d.*?) ?([ap])\.?m\.?", re.IGNORECASE)
_MONTHS = 12


def date_s(cell: str, *, month_first: bool = True) -> float | None:
    """Return a date, or the time of a day, in seconds; None where it is neither.

    Of two numbers with a slash between them, and the year behind, the first is the month, or the day.

    >>> date_s("31.1.1970 9:00:00,5") == date_s("1970/01/31 09:00:00.5") == date_s("1970-01-31T09:00:00.5")
    True
    >>> date_s("1/31/1970 9:00 PM") == date_s("31/1/1970 21:00", month_first=False) == date_s("1970-01-31 21:00")
    True
    >>> date_s("31/1/1970"), date_s("noon")
    (None, None)
    """
    if match := _DATE.fullmatch(cell):
        cell = f"{_day(match, month_first=month_first)}T{_clock(match['rest'] or '00:00')}"
    try:
        found = datetime.fromisoformat(cell)
    except ValueError:
        try:
            found = datetime.combine(datetime.fromtimestamp(0, UTC), day_time.fromisoformat(_clock(cell)))
        except ValueError:
            return None
    return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()


def is_ambiguous(cell: str) -> bool:
    """Return whether the cell is a date of which other rows say whether the month or the day is first.

    >>> is_ambiguous("9/6/2017 00:01"), is_ambiguous("2017-09-06 00:01")
    (True, False)
    """
    match = _DATE.fullmatch(cell)
    return match is not None and match["one"] is not None


def is_month_first(cells: Iterable[str]) -> bool:
    """Return whether the month is first in the dates of rows in a row.

    A number above 12 is the day. Where there is none, dates go on in the smaller steps; else it is the month.

    >>> is_month_first(["9/6/2017", "9/7/2017"]), is_month_first(["6/9/2017", "7/9/2017"])
    (True, False)
    >>> is_month_first(["1/2/2017", "13/2/2017"]), is_month_first(["1/2/2017"])
    (False, True)
    """
    last, steps = "", [0, 0]
    before: tuple[date, date] | None = None
    for cell in cells:
        match = _DATE.fullmatch(cell)
        if match is None or match["one"] is None or (stem := cell[: match.end("last")]) == last:
            continue
        last = stem
        one, two, year = (int(match[name]) for name in ("one", "two", "last"))
        if max(one, two) > _MONTHS:
            return two > _MONTHS
        if not (one and two and year):
            continue
        now = date(year, one, two), date(year, two, one)
        if before is not None:
            steps = [step + abs((new - old).days) for step, new, old in zip(steps, now, before, strict=True)]
        before = now
    return steps[0] <= steps[1]


def _day(match: re.Match[str], *, month_first: bool) -> str:
    if match["day"]:
        day, month, year = match.group("day", "month", "year")
    elif match["d"]:
        day, month, year = match.group("d", "m", "y")
    else:
        one, two, year = match.group("one", "two", "last")
        day, month = (two, one) if month_first else (one, two)
    return f"{year}-{int(month):02}-{int(day):02}"


def _clock(text: str) -> str:
    """Return the time of a day with two digits of the hour, of 24."""
    if half := _HALF_DAY.fullmatch(text):
        hour = int(half[1]) % 12 + (12 if half[3] in "pP" else 0)
        return f"{hour:02}{half[2].strip()}"
    return text if text[1:2] != ":" else f"0{text}"
