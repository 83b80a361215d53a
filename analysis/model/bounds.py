"""Bounds of signals in a model file: where = {dc_dose = {above = 0.0, below = 0.02}}."""

from collections.abc import Mapping

from faultline.analysis.model.tables import Table

Bounds = Mapping[str, tuple[float | None, float | None]]
"""Open intervals of signals by their names: above and below, None is no bound."""


def bounds_of(table: Table) -> dict[str, tuple[float | None, float | None]]:
    """Return the bounds in `where` of a table, none where that is absent.

    Raises:
        ModelError: a bound is no number, or nothing is between the two.
    """
    where, found = table.table("where"), {}
    written = {} if where is None else where.rest()
    for name, part in Table({"where": written}, table.place).named_tables("where").items():
        above, below = part.optional_number("above"), part.optional_number("below")
        part.done()
        if above is None and below is None:
            raise part.fail("below", "give `above`, `below` or both")
        if above is not None and below is not None and not above < below:
            raise part.fail("below", f"{below:g} is not above {above:g}")
        found[name] = (above, below)
    return found
