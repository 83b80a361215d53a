"""Names that formulas can have, for columns of any name."""

import re
from collections.abc import Iterable

from faultline.analysis.model.check import is_name


def names_of(columns: Iterable[str]) -> dict[str, str]:
    """Return a name for each column, its own where that is one; no two are the same.

    >>> names_of(["Volume Flow", "Volume_Flow", "2nd [bar]", "exp"])
    {'Volume Flow': 'Volume_Flow_2', 'Volume_Flow': 'Volume_Flow', '2nd [bar]': 'x_2nd_bar', 'exp': 'x_exp'}
    """
    columns = list(columns)
    found = {column: column for column in columns if is_name(column)}
    for column in columns:
        if column in found:
            continue
        plain = re.sub(r"[^A-Za-z0-9]+", "_", column).strip("_")
        name = plain if is_name(plain) else f"x_{plain}".rstrip("_")
        others, number = {*found.values()}, 2
        free = name
        while free in others:
            free, number = f"{name}_{number}", number + 1
        found[column] = free
    return {column: found[column] for column in columns}
