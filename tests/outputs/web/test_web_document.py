"""The API document says what the server does: schemathesis asks by the document, and every answer must be in it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, seed, settings
from schemathesis.checks import CHECKS
from test_web_api import BEARER
from web_daemon import FakeDaemon, fault
from web_server import TOKEN, Serving, serving

from faultline.service.web.app import table
from faultline.service.web.document import document
from faultline.service.web.routes import Routes

NOT_OURS = {
    "use_after_free",  # what was cleared may fail again, and numbers are the daemon's
    "ensure_resource_availability",  # nothing is made by a request
}
"""Checks for what this API has not."""

SCHEMA: Any = schemathesis.openapi.from_dict(document())
ASKED = SCHEMA.exclude(path_regex="^/v1/(events|live/.*)$")  # they do not end; their errors are asked for below


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[FakeDaemon, Serving]]:
    folder = tmp_path_factory.mktemp("document")
    (folder / "tokens").write_text(TOKEN)
    (folder / "tokens").chmod(0o600)
    with FakeDaemon(folder) as daemon:
        daemon.tell(*range(1, 31))
        places = ("--control", str(daemon.control), "--events", str(daemon.events))
        arguments = (*places, "--listen", "127.0.0.1:0", "--token-file", str(folder / "tokens"))
        with serving(*arguments, log=folder / "log") as running:
            yield daemon, running
        assert running.log.read_text().count("\n") == 1, running.log.read_text()


def test_the_document_has_every_route_and_no_other() -> None:
    routes = {
        route.path: route.methods for route in table(Routes.__new__(Routes)) if route.path.startswith(("/v1", "/m"))
    }
    described = {path: {method.upper() for method in methods} for path, methods in document()["paths"].items()}
    assert routes == described


def test_the_server_serves_it(server: tuple[FakeDaemon, Serving]) -> None:
    with server[1].client() as client:
        assert client.get("/v1/openapi.json").json() == document()


@ASKED.parametrize()  # type: ignore[untyped-decorator]  # the schema is made from a document
@seed(2026)
@settings(
    max_examples=20, deadline=None, database=None, phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
def test_every_answer_is_in_it(case: Any, server: tuple[FakeDaemon, Serving]) -> None:
    daemon, running = server
    daemon.faults = {number: fault(number) for number in (1, 2, 3)}
    if case.meta.generation.mode.is_positive and case.path_parameters:
        known = {"system": "uds", "code": "3"}
        case.path_parameters = {name: known[name] for name in case.path_parameters}  # else there is nothing to answer
    checks = CHECKS.get_by_names([name for name in CHECKS.get_all_names() if name not in NOT_OURS])
    case.call_and_validate(base_url=running.url, headers=BEARER, checks=checks)


@pytest.mark.parametrize(
    ("method", "path", "options", "status"),
    [
        ("GET", "/v1/events", {"params": {"after": "x y"}}, 400),
        ("GET", "/v1/events", {"headers": {"Last-Event-ID": "x y"}}, 400),
        ("GET", "/v1/events", {"headers": {"Sec-Fetch-Site": "cross-site"}}, 403),
        ("GET", "/v1/live/{system}", {"params": {"a": "b"}}, 400),
        ("GET", "/v1/live/{system}", {}, 404),
        ("GET", "/v1/events", {"headers": {"Host": "evil.example"}}, 421),
        ("GET", "/v1/components", {"content": b"x" * 70_000}, 413),
        ("GET", "/v1/components", {"headers": {"X": "y" * 17_000}}, 431),
        ("GET", "/v1/components", {"params": {"x": "y" * 9000}}, 414),
        ("DELETE", "/v1/components/{system}/faults", {}, 401),
        ("DELETE", "/v1/components/{system}/faults", {"headers": {"Authorization": "Bearer wrong"}}, 403),
        ("DELETE", "/v1/components/{system}/faults", {"headers": BEARER}, 404),
    ],
)
def test_errors_are_in_it(
    server: tuple[FakeDaemon, Serving], method: str, path: str, options: dict[str, Any], status: int
) -> None:
    with server[1].client() as client:
        response = client.request(method, path.replace("{system}", "none"), **options)
    assert response.status_code == status
    SCHEMA[path][method.lower()].validate_response(response)


@pytest.mark.parametrize("path", [path for path in document()["paths"] if not path.startswith("/v1/events")])
def test_a_daemon_that_is_away_is_in_it(tmp_path: Path, path: str, away: Serving) -> None:
    with away.client() as client:
        response = client.get(path.replace("{system}", "uds").replace("{code}", "1"))
    SCHEMA[path]["get"].validate_response(response)


@pytest.fixture(scope="module")
def away(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    folder = tmp_path_factory.mktemp("away")
    places = ("--control", str(folder / "c"), "--events", str(folder / "e"), "--listen", "127.0.0.1:0")
    with serving(*places, log=folder / "log") as running:
        yield running


def test_a_document_where_all_need_a_token() -> None:
    guarded = document(guarded=True)
    for methods in guarded["paths"].values():
        for operation in methods.values():
            assert operation["security"] == [{"token": []}]
            assert "401" in operation["responses"]
