"""The real server before a fake daemon: what tools are answered, and what they are refused."""

import re
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from test_web_metrics import one, strictly
from web_daemon import PASSED, FakeDaemon, fault
from web_server import TOKEN, Serving, serving, until

from faultline.service.web.limits import Limits

BEARER = {"Authorization": f"Bearer {TOKEN}"}
OTHER = {"Authorization": f"Bearer {'x' * 40}"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("api")


@pytest.fixture(scope="module")
def the_daemon(folder: Path) -> Iterator[FakeDaemon]:
    with FakeDaemon(folder) as made:
        made.tell(*range(1, 21))
        yield made


@pytest.fixture(scope="module")
def server(the_daemon: FakeDaemon, folder: Path) -> Iterator[Serving]:
    tokens = folder / "tokens"
    tokens.write_text(f"{TOKEN}\n{'y' * 32}\n")
    tokens.chmod(0o600)
    control, events = str(the_daemon.control), str(the_daemon.events)
    arguments = ("--control", control, "--events", events, "--listen", "127.0.0.1:0", "--token-file", str(tokens))
    with serving(*arguments, log=folder / "log", orderly=True) as running:
        yield running
    assert running.log.read_text().count("\n") == 1, "it had something to say"


@pytest.fixture
def daemon(the_daemon: FakeDaemon) -> FakeDaemon:
    """As it is at first, for each test."""
    the_daemon.faults = {1: fault(1), 2: fault(2, state=PASSED), 3: fault(3, system="doors")}
    the_daemon.systems = ["uds", "doors"]
    the_daemon.conditions, the_daemon.refusing, the_daemon.silent = [], None, False
    return the_daemon


@pytest.fixture(scope="module")
def the_client(server: Serving) -> Iterator[httpx.Client]:
    with server.client() as made:
        yield made


@pytest.fixture
def client(the_client: httpx.Client, daemon: FakeDaemon) -> httpx.Client:
    until(lambda: codes(the_client) == ["1", "2"])  # an answer is good for a fifth of a second
    return the_client


def codes(client: httpx.Client, system: str = "uds") -> list[str]:
    answer = client.get(f"/v1/components/{system}/faults")
    return [item["code"] for item in answer.json()["items"]] if answer.status_code == 200 else []


def problem(answer: httpx.Response) -> tuple[int, str]:
    """Status and code of a problem document, which says the same as the answer."""
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert [*body] == ["type", "title", "status", "detail", "code"]
    assert body["status"] == answer.status_code
    assert body["type"] == f"urn:faultline:problem:{body['code']}"
    assert body["detail"]
    return answer.status_code, body["code"]


class TestReading:
    def test_components_are_the_systems_and_what_is_remembered_of_others(
        self, client: httpx.Client, daemon: FakeDaemon
    ) -> None:
        items = client.get("/v1/components").json()["items"]
        assert items == [{"id": name, "name": name, "href": f"/v1/components/{name}"} for name in ("uds", "doors")]
        daemon.systems = ["uds"]
        daemon.faults[3] = fault(3, system="an old one/ü")
        until(lambda: client.get("/v1/components").json()["items"][-1]["id"] == "an old one/ü")

    def test_a_component_says_where_to_go_on_and_that_is_there(self, client: httpx.Client) -> None:
        component = client.get("/v1/components/uds").json()
        assert client.get(component["faults"]).status_code == 200
        assert client.get(component["system"]).json()["name"] == "uds"

    def test_a_system_that_is_not_watched_any_more_has_its_faults(
        self, client: httpx.Client, daemon: FakeDaemon
    ) -> None:
        daemon.systems = ["uds"]
        until(lambda: client.get("/v1/systems/doors").status_code == 404)
        until(lambda: codes(client, "doors") == ["3"])
        found = client.get("/v1/components/doors/faults").json()["items"][0]
        assert found["fault_name"] == "fA_du or fy_p_ap"

    def test_faults_and_one_of_them(self, client: httpx.Client) -> None:
        items = client.get("/v1/components/uds/faults").json()["items"]
        assert [item["code"] for item in items] == ["1", "2"]
        detail = client.get("/v1/components/uds/faults/2").json()
        assert detail["item"] == items[1]
        assert detail["environment_data"]["snapshots"][0]["data"]["tick"] == 12
        assert detail["environment_data"]["extended_data_records"]["occurrences"] == 2

    @pytest.mark.parametrize(
        ("query", "found"),
        [
            ("status[confirmedDtc]=true", ["1", "2"]),
            ("status%5BtestFailed%5D=1", ["1"]),
            ("status[testFailed]=0&severity=3", ["2"]),
            ("status[aggregatedStatus]=cleared", []),
        ],
    )
    def test_filters(self, client: httpx.Client, query: str, found: list[str]) -> None:
        items = client.get(f"/v1/components/uds/faults?{query}").json()["items"]
        assert [item["code"] for item in items] == found

    @pytest.mark.parametrize(
        ("path", "status", "code"),
        [
            ("/v1/components/none", 404, "unknown"),
            ("/v1/components/none/faults", 404, "unknown"),
            ("/v1/components/uds/faults/99", 404, "unknown"),
            ("/v1/components/uds/faults/3", 404, "unknown"),  # it is the other system's
            ("/v1/components/uds/faults/x", 400, "bad-request"),
            ("/v1/components/uds/faults/0", 400, "bad-request"),
            ("/v1/components/uds/faults/01", 400, "bad-request"),
            ("/v1/components/uds/faults/%D9%A1", 400, "bad-request"),
            ("/v1/components/%00/faults", 400, "bad-request"),
            ("/v1/components/a%0D%0AX:y/faults", 400, "bad-request"),
            (f"/v1/components/{'a' * 201}/faults", 400, "bad-request"),
            ("/v1/components/%ff%fe/faults", 404, "unknown"),
            ("/v1/components/uds/faults?stat=1", 400, "bad-query"),
            ("/v1/systems/none", 404, "unknown"),
            ("/v1/live/none", 404, "unknown"),
            ("/v1/records?count=0", 400, "bad-query"),
            ("/v1/events?after=a%20b", 400, "bad-request"),
            ("/v1/components/", 404, "no-route"),
            ("/v1/components/uds/faults/", 404, "no-route"),
            ("/v2/health", 404, "no-route"),
            ("/static/none.js", 404, "no-route"),
            ("/static/../routes.py", 404, "no-route"),
            ("/static/%2e%2e/routes.py", 404, "no-route"),
            ("/static//etc/passwd", 404, "no-route"),
        ],
    )
    def test_what_is_not_there_or_makes_no_sense(self, client: httpx.Client, path: str, status: int, code: str) -> None:
        assert problem(client.get(path)) == (status, code)

    def test_records_are_pages(self, client: httpx.Client, daemon: FakeDaemon) -> None:
        def seqs(query: str) -> list[int]:
            return [each["seq"] for each in client.get(f"/v1/records?{query}").json()["records"]]

        last = daemon.told[-1].seq
        assert seqs("after=3&count=4") == [4, 5, 6, 7]
        assert seqs("before=3") == [1, 2]
        assert seqs("after=3&before=7") == [4, 5, 6]
        assert seqs("after=3&before=7&count=2") == [4, 5]
        assert seqs("after=7&before=3") == []
        assert seqs("count=2") == [last - 1, last]
        assert seqs(f"after={last}") == []

    def test_health_ready_and_figures(self, client: httpx.Client, daemon: FakeDaemon) -> None:
        answer = client.get("/v1/health")
        assert (answer.status_code, answer.json()["status"], answer.json()["cursor"]) == (200, "well", 20)
        assert client.get("/v1/ready").json() == {"ready": True}
        daemon.conditions = [{"kind": "no-traffic", "of": "can", "since": "2026-03-01T10:00:00Z"}]
        until(lambda: client.get("/v1/health").status_code == 503)
        answer = client.get("/v1/health")
        assert answer.headers["content-type"] == "application/json"
        assert (answer.json()["status"], answer.headers["retry-after"]) == ("blind", "1")
        assert client.get("/v1/ready").status_code == 200
        answer = client.get("/metrics")
        assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
        figures = strictly(answer.content)
        assert one(figures, "faultline_condition", kind="no-traffic", of="can") == 1
        assert one(figures, "faultline_http_subscribed") == 1
        assert one(figures, "faultline_http_requests_total", method="GET", code="503") >= 2

    def test_answers_do_not_wait_for_the_network(self, client: httpx.Client) -> None:
        """Nagle's algorithm with delayed acknowledgements took 44 ms for every answer."""
        times = []
        for _ in range(100):
            begun = time.perf_counter()
            client.get("/v1/ready")
            times.append(time.perf_counter() - begun)
        assert sorted(times[40:])[15] < 0.03  # the kernel acknowledges the first ones at once; others use the machine

    def test_the_page(self, client: httpx.Client) -> None:
        answer = client.get("/")
        assert answer.headers["content-type"] == "text/html; charset=utf-8"
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self';" in policy
        assert "unsafe" not in policy
        for link in re.findall(r'href="([^"]+)"', answer.text):
            assert client.get(link).status_code in (200, 503), link
        again = client.get("/", headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
        assert client.get("/static/index.html").content == answer.content


class TestClearing:
    def test_one(self, client: httpx.Client, daemon: FakeDaemon) -> None:
        answer = client.delete("/v1/components/uds/faults/1", headers=BEARER)
        assert (answer.status_code, answer.content) == (204, b"")
        assert sorted(daemon.faults) == [2, 3]
        assert codes(client) == ["2"], "what was cleared is gone for who asks next"
        assert problem(client.delete("/v1/components/uds/faults/1", headers=BEARER)) == (404, "unknown")

    def test_all_of_a_system_leaves_those_of_others(self, client: httpx.Client, daemon: FakeDaemon) -> None:
        assert client.delete("/v1/components/uds/faults", headers=BEARER).status_code == 204
        assert sorted(daemon.faults) == [3]
        assert codes(client) == []

    def test_all_there_is_goes_at_once_and_the_overflow_flag_with_it(
        self, client: httpx.Client, daemon: FakeDaemon
    ) -> None:
        daemon.systems = ["uds"]
        del daemon.faults[3]
        until(lambda: client.get("/v1/components/doors").status_code == 404)
        assert client.delete("/v1/components/uds/faults", headers=BEARER).status_code == 204
        assert not daemon.faults
        assert daemon.asked[-1] == {"ask": "clear"}

    @pytest.mark.parametrize("path", ["/v1/components/uds/faults/1", "/v1/components/uds/faults"])
    @pytest.mark.parametrize(
        ("headers", "status", "code"),
        [
            ({}, 401, "no-token"),
            ({"Authorization": "Basic eDp5"}, 401, "no-token"),
            ({"Authorization": f"Bearer {TOKEN} {TOKEN}"}, 401, "no-token"),
            (OTHER, 403, "wrong-token"),
            ({"Authorization": f"Bearer {TOKEN[:-1]}"}, 403, "wrong-token"),
            ({"Authorization": f"Bearer {TOKEN}t"}, 403, "wrong-token"),
        ],
    )
    def test_nobody_without_a_token(
        self, client: httpx.Client, daemon: FakeDaemon, path: str, headers: dict[str, str], status: int, code: str
    ) -> None:
        answer = client.delete(path, headers=headers)
        assert problem(answer) == (status, code)
        assert ("www-authenticate" in answer.headers) == (status == 401)
        assert sorted(daemon.faults) == [1, 2, 3]

    def test_any_of_the_tokens(self, client: httpx.Client) -> None:
        headers = {"Authorization": f"Bearer {'y' * 32}"}
        assert client.delete("/v1/components/uds/faults/2", headers=headers).status_code == 204

    @pytest.mark.parametrize("path", ["/v1/components/uds/faults/2", "/v1/components/uds/faults"])
    @pytest.mark.parametrize(
        ("refusing", "status", "code"),
        [("not-kept", 500, "not-kept"), ("not-allowed", 403, "not-allowed"), ("not-kept at 2", 500, "not-kept")],
    )
    def test_what_the_store_did_not_take_is_not_done(
        self, client: httpx.Client, daemon: FakeDaemon, path: str, refusing: str, status: int, code: str
    ) -> None:
        daemon.refusing = refusing
        assert problem(client.delete(path, headers=BEARER)) == (status, code)

    @pytest.mark.parametrize(
        ("path", "status"),
        [
            ("/v1/components/none/faults", 404),
            ("/v1/components/uds/faults/99", 404),
            ("/v1/components/uds/faults/3", 404),
            ("/v1/components/uds/faults/x", 400),
            ("/v1/components/uds/faults?severity=2", 400),  # a filter must not be taken for all
        ],
    )
    def test_what_is_not_there(self, client: httpx.Client, daemon: FakeDaemon, path: str, status: int) -> None:
        assert problem(client.delete(path, headers=BEARER))[0] == status
        assert sorted(daemon.faults) == [1, 2, 3]


class TestGate:
    @pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "HEAD", "OPTIONS", "TRACE", "BREW"])
    def test_other_methods(self, client: httpx.Client, method: str) -> None:
        answer = client.request(method, "/v1/components/uds/faults/1")
        assert answer.status_code == 405
        assert sorted(answer.headers["allow"].split(", ")) == ["DELETE", "GET"]
        assert client.request(method, "/v1/events").headers["allow"] == "GET"

    @pytest.mark.parametrize("path", ["/v1/health", "/nothing", "/v1/components/uds/faults/1", "/metrics", "/"])
    def test_what_every_answer_says(self, client: httpx.Client, path: str) -> None:
        for answer in (client.get(path), client.delete(path)):
            assert answer.headers["x-content-type-options"] == "nosniff"
            assert answer.headers["cache-control"] == (
                "no-cache" if answer.url.path == "/" and answer.is_success else "no-store"
            )
            assert "default-src 'none'" in answer.headers["content-security-policy"]
            assert "access-control-allow-origin" not in answer.headers
            assert "server" not in answer.headers

    @pytest.mark.parametrize("host", ["evil.example", "127.0.0.2", "localhost.evil.example", "", "169.254.169.254:80"])
    def test_names_that_are_not_this_machines(self, client: httpx.Client, host: str) -> None:
        assert problem(client.get("/v1/health", headers={"Host": host})) == (421, "host")

    @pytest.mark.parametrize("host", ["localhost", "LocalHost:9", "127.0.0.1", "[::1]:8080"])
    def test_names_that_are(self, client: httpx.Client, host: str) -> None:
        assert client.get("/v1/health", headers={"Host": host}).status_code == 200

    def test_pages_of_other_sites_may_link_here_and_no_more(self, client: httpx.Client) -> None:
        for site in ("cross-site", "same-site"):
            headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": "no-cors"}
            assert problem(client.get("/v1/events", headers=headers)) == (403, "cross-site")
        headers = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
        assert client.get("/", headers=headers).status_code == 200
        assert client.get("/v1/ready", headers={"Sec-Fetch-Site": "same-origin"}).status_code == 200

    def test_a_body_is_left_alone_up_to_a_limit(self, client: httpx.Client) -> None:
        most = Limits().body
        assert client.request("GET", "/v1/ready", content=b"x" * most).status_code == 200
        assert problem(client.request("GET", "/v1/ready", content=b"x" * (most + 1))) == (413, "too-long")
        assert client.request("GET", "/v1/ready", content=iter([b"x" * most])).status_code == 200
        chunks = iter([b"x" * most, b"x"])
        assert problem(client.request("GET", "/v1/ready", content=chunks)) == (413, "too-long")

    def test_headers_are_limited(self, client: httpx.Client) -> None:
        many = {f"x-{number}": "1" for number in range(Limits().headers + 1)}
        assert problem(client.get("/v1/ready", headers=many)) == (431, "too-many-headers")
        assert client.get("/v1/ready", headers=dict([*many.items()][:40])).status_code == 200
        assert problem(client.get("/v1/ready", headers={"x": "y" * 20_000})) == (431, "too-many-headers")
        assert problem(client.get(f"/v1/ready?{'y' * 9000}")) == (414, "too-long-target")
