"""Model files of faultline 0.1: one table `[modes]` with fixed names, and a sampling period of 0.2 s for every system.

[modes]   signal, idle_below, maximum_above, settle_s, edges = {n_p = 4.0}
"""

from collections.abc import Mapping

from faultline.analysis.model.tables import Table

PERIOD_S = 0.2


def as_written_today(model: Mapping[str, object], where: str) -> dict[str, object]:
    """The tables of a model as this version writes them; those that are of this version as they are.

    Raises:
        ModelError: the old table is not valid.
    """
    table = Table(model, where, top=True).table("modes")
    if table is None:
        return dict(model)
    signal, edges = table.text("signal"), table.table("edges")
    low, high = table.optional_number("idle_below"), table.optional_number("maximum_above")
    settle_s = table.optional_number("settle_s")
    table.done()
    idle = [] if low is None else [{"name": "idle", "where": {signal: {"below": low}}}]
    maximum = [] if high is None else [{"name": "maximum", "where": {signal: {"above": high}}}]
    found = {key: value for key, value in model.items() if key != "modes"}
    found |= {"period_s": PERIOD_S, "mode": [*idle, {"name": "partial"}, *maximum]}
    return found | ({} if edges is None else {"edges": {"settle_s": settle_s, "steps": edges.rest()}})
