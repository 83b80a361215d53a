"""Health of the daemon in one word, from its state: pure."""

from faultline.service.core.records.health import Standing, meaning
from faultline.service.protocol.answers import ServiceState
from faultline.service.web.shapes import HealthBody

BLINDING = frozenset(("bus-down", "bus-removed", "bus-off", "no-traffic", "bundle-failed", "bundle-refused"))
"""Conditions with which nothing of a system can be told: silence is then not "no fault"."""


def health_of(state: ServiceState) -> HealthBody:
    """Return the body for a daemon that answers."""
    blind = [each for each in state.conditions if each.kind in BLINDING]
    stands = blind or state.conditions
    return HealthBody(
        status="blind" if blind else "degraded" if stands else "well",
        detail="; ".join(_said(each) for each in stands) or "nothing stands",
        source=state.source,
        version=state.version,
        since=state.since,
        wall=state.wall,
        cycle=state.cycle,
        cursor=state.seq,
        conditions=state.conditions,
        store=state.store,
        buses=state.buses,
        systems=state.systems,
    )


def away(reason: str) -> HealthBody:
    """Return the body for a daemon that does not answer."""
    return HealthBody(status="away", detail=reason)


def is_well(body: HealthBody) -> bool:
    """Return True if silence means "no fault" as far as the daemon goes."""
    return body.status in ("well", "degraded")


def _said(condition: Standing) -> str:
    return f"{condition.of} {meaning(condition.kind)}"
