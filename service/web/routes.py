"""Routes of the API: each asks the daemon and converts its answer."""

from collections.abc import Mapping
from urllib.parse import quote

import msgspec
from starlette.requests import Request
from starlette.responses import Response

from faultline.service.core.records.fault import Fault
from faultline.service.protocol.errors import ProtocolError
from faultline.service.web import metrics
from faultline.service.web.document import document
from faultline.service.web.events import Hub, stream
from faultline.service.web.faults import detail_of, item_of, selected
from faultline.service.web.health import away, health_of, is_well
from faultline.service.web.limits import require
from faultline.service.web.live import Live
from faultline.service.web.page import INDEX, load_page, serve
from faultline.service.web.problems import RETRY, RequestError, error_of
from faultline.service.web.queries import (
    filter_of,
    nothing_in,
    number_of,
    page_of,
    part_of,
    parts_of,
    place_of,
    system_of,
)
from faultline.service.web.shapes import Capabilities, Component, Components, HealthBody, Items, Ready
from faultline.service.web.stream import Stream, Streams
from faultline.service.web.tokens import Tokens
from faultline.service.web.vehicle import Vehicle


class Routes:
    """Handlers of requests. `vehicle` answers, `hub` has the events, `live` the ticks; `tokens` may clear.

    `guarded`: every request needs a token.
    """

    def __init__(
        self, vehicle: Vehicle, hub: Hub, live: Live, streams: Streams, tokens: Tokens, *, guarded: bool
    ) -> None:
        self._vehicle, self._hub, self._live = vehicle, hub, live
        self._streams, self._tokens = streams, tokens
        self._page = load_page()
        self._document = msgspec.json.encode(document(guarded=guarded))

    async def components(self, request: Request) -> Response:
        """Return the watched systems, and those with remembered faults besides."""
        nothing_in(request.query_params)
        names = await self._vehicle.systems()
        items = [Component(id=name, name=name, href=f"/v1/components/{quote(name, safe='')}") for name in names]
        return _json(Components(items=items))

    async def component(self, request: Request) -> Response:
        """Return one of the systems."""
        nothing_in(request.query_params)
        name = await self._system(request)
        path = quote(name, safe="")
        body = Capabilities(
            id=name,
            name=name,
            faults=f"/v1/components/{path}/faults",
            system=f"/v1/systems/{path}",
            live=f"/v1/live/{path}",
            history=f"/v1/history/{path}" if (await self._vehicle.state()).is_recording else None,
        )
        return _json(body)

    async def faults(self, request: Request) -> Response:
        """Return the remembered faults of a system, filtered."""
        wanted = filter_of(request.query_params)
        name = await self._system(request)
        meanings = await self._vehicle.meanings(name)
        items = [item_of(fault, meanings) for fault in await self._vehicle.faults(name)]
        return _json(Items(items=selected(items, wanted.status, wanted.severity, wanted.scope)))

    async def fault(self, request: Request) -> Response:
        """Return one fault with its environment data."""
        extended, snapshots = parts_of(request.query_params)
        name = system_of(request)
        found = await self._vehicle.fault(name, number_of(request))
        meanings = await self._vehicle.meanings(name)
        return _json(detail_of(found.fault, meanings, found.frames, extended=extended, snapshots=snapshots))

    async def clear(self, request: Request) -> Response:
        """Erase one fault; on return that is on the disk."""
        self._may_clear(request)
        nothing_in(request.query_params)
        found = await self._vehicle.fault(system_of(request), number_of(request))
        await self._vehicle.erase(found.fault.number)
        return Response(None, 204)

    async def clear_all(self, request: Request) -> Response:
        """Erase all remembered faults of a system."""
        self._may_clear(request)
        nothing_in(request.query_params)
        await self._vehicle.erase_all(await self._system(request))
        return Response(None, 204)

    async def health(self, request: Request) -> Response:
        """Return the daemon's health; 503 if silence does not mean "no fault"."""
        body = await self._how(request)
        return _json(body) if is_well(body) else _json(body, 503, RETRY)

    async def state(self, request: Request) -> Response:
        """Return the same as 200 in any case: for clients that poll it to show it."""
        return _json(await self._how(request))

    async def ready(self, request: Request) -> Response:
        """Return 200 if the daemon answers."""
        nothing_in(request.query_params)
        await self._vehicle.state()
        return _json(Ready())

    async def records(self, request: Request) -> Response:
        """Return a page of records."""
        return _json(await self._vehicle.records(page_of(request.query_params)))

    async def system(self, request: Request) -> Response:
        """Return what a system's names mean, as the daemon answers."""
        nothing_in(request.query_params)
        return _json(await self._vehicle.description(system_of(request)))

    async def events(self, request: Request) -> Stream:
        """Stream the records from a place on."""
        place = place_of(request)
        return Stream("events", stream(self._hub, place, self._streams.limits.alive_s), self._streams)

    async def ticks(self, request: Request) -> Stream:
        """Stream the live values of a system."""
        nothing_in(request.query_params)
        name = system_of(request)
        self._streams.seat()
        if name not in [each.name for each in (await self._vehicle.state()).systems]:
            raise RequestError(404, "unknown", f"no system {name!r} is watched")
        return Stream("live", self._live.stream(name, self._streams.limits.alive_s), self._streams)

    async def history(self, request: Request) -> Response:
        """Return the ticks of a finished recording, any part of them."""
        part = part_of(request.query_params)
        return _json(await self._vehicle.history(system_of(request), part))

    async def metrics(self, request: Request) -> Response:
        """Return the metrics, of this server too if the daemon does not answer."""
        nothing_in(request.query_params)
        counts = self._streams.counts
        try:
            of_daemon = metrics.of_daemon(await self._vehicle.state(), await self._vehicle.faults())
        except ProtocolError:
            of_daemon = metrics.of_daemon(None, list[Fault]())  # `faultline_up` says so
        families = [*of_daemon, *metrics.of_server(counts, subscribed=self._hub.there)]
        return Response(metrics.render(families), headers={"content-type": metrics.CONTENT_TYPE})

    async def document(self, request: Request) -> Response:
        """Return the API document."""
        nothing_in(request.query_params)
        return Response(self._document, media_type="application/json")

    async def index(self, request: Request) -> Response:
        """Return the page."""
        return serve(self._page, INDEX, request)

    async def static(self, request: Request) -> Response:
        """Return a file of the page."""
        return serve(self._page, request.path_params["name"], request)

    async def _how(self, request: Request) -> HealthBody:
        """Return the daemon's health."""
        nothing_in(request.query_params)
        try:
            return health_of(await self._vehicle.state())
        except ProtocolError as error:
            return away(error_of(error).detail)

    async def _system(self, request: Request) -> str:
        """Return the system in the path; raises RequestError if there is none of that name."""
        name = system_of(request)
        if name not in await self._vehicle.systems():
            raise RequestError(404, "unknown", f"there is no system {name!r}")
        return name

    def _may_clear(self, request: Request) -> None:
        if not self._tokens:
            raise RequestError(403, "not-configured", "clearing is not configured: this server has no token file")
        require(self._tokens, request.headers)


def _json(body: object, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    return Response(msgspec.json.encode(body), status, headers, "application/json")
