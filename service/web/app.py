"""ASGI application: routes by path, their connection to the daemon, and the gate before all of them."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp

from faultline.service.protocol.errors import ProtocolError
from faultline.service.web.events import Hub
from faultline.service.web.limits import Gate, Limits
from faultline.service.web.live import Live
from faultline.service.web.metrics import Counts
from faultline.service.web.problems import RequestError, told
from faultline.service.web.routes import Routes
from faultline.service.web.settings import Settings
from faultline.service.web.stream import Stream, Streams
from faultline.service.web.tokens import Tokens
from faultline.service.web.vehicle import Vehicle
from faultline.service.web.waiting import Shutdown

Handler = Callable[[Request], Awaitable[Response | Stream]]


def application(
    settings: Settings, tokens: Tokens, limits: Limits, counts: Counts, shutdown: Shutdown, say: Callable[[str], None]
) -> ASGIApp:
    """Return the application for a daemon at the settings' sockets."""
    vehicle = Vehicle(Path(settings.control), limits.answer_s, limits.clear_s)
    hub = Hub(Path(settings.events), vehicle, counts, say)
    streams = Streams(limits, counts, shutdown)
    guarded = settings.allow_remote
    routes = Routes(vehicle, hub, Live(vehicle, shutdown, say), streams, tokens, guarded=guarded)
    return Gate(_app(routes, hub, shutdown), limits, counts, settings.hosts, tokens if guarded else None)


def table(routes: Routes) -> list[Route]:
    """Return the routes by path."""
    return [
        _route("/", GET=routes.index),
        _route("/static/{name:path}", GET=routes.static),
        _route("/metrics", GET=routes.metrics),
        _route("/v1/openapi.json", GET=routes.document),
        _route("/v1/health", GET=routes.health),
        _route("/v1/state", GET=routes.state),
        _route("/v1/ready", GET=routes.ready),
        _route("/v1/components", GET=routes.components),
        _route("/v1/components/{system}", GET=routes.component),
        _route("/v1/components/{system}/faults", GET=routes.faults, DELETE=routes.clear_all),
        _route("/v1/components/{system}/faults/{code}", GET=routes.fault, DELETE=routes.clear),
        _route("/v1/systems/{system}", GET=routes.system),
        _route("/v1/live/{system}", GET=routes.ticks),
        _route("/v1/history/{system}", GET=routes.history),
        _route("/v1/events", GET=routes.events),
        _route("/v1/records", GET=routes.records),
    ]


def _app(routes: Routes, hub: Hub, shutdown: Shutdown) -> Starlette:
    """Return the routes with a task that receives events; if that fails, this server ends."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(hub.run())
        shutdown.watch(task)
        yield
        task.cancel()

    known = (RequestError, ProtocolError, HTTPException, Exception)
    app = Starlette(routes=table(routes), lifespan=lifespan, exception_handlers=dict.fromkeys(known, told))
    app.router.redirect_slashes = False
    return app


def _route(path: str, **handlers: Handler) -> Route:
    """Return a path with its methods and no other: a GET is no HEAD here, as a stream has no end to wait for."""

    async def answer(request: Request) -> Response | Stream:
        return await handlers[request.method](request)

    route = Route(path, answer, methods=[*handlers])
    route.methods = set(handlers)
    return route
