"""The API document (OpenAPI 3.1), made from the same structs that are answered and the same patterns that are checked.

Source: OpenAPI 3.1.1; schemas are JSON Schema 2020-12.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from faultline.service.core.records.context import Context
from faultline.service.core.records.event import Event
from faultline.service.core.records.fault import Cleared, FaultRecord
from faultline.service.core.records.health import Health
from faultline.service.web import metrics, queries, shapes
from faultline.service.web.faults import AGGREGATED, STATUS_KEYS
from faultline.service.web.problems import MEDIA_TYPE

Json = dict[str, Any]

RECORDS = (Event, Health, FaultRecord, Cleared, Context)
BODIES = (
    *(shapes.Components, shapes.Capabilities, shapes.Items, shapes.Detail, shapes.HealthBody, shapes.Ready),
    shapes.Problem,
)

PROBLEMS = {
    400: "what is asked makes no sense",
    401: "a token is needed",
    403: "not allowed: another site's page, a wrong token, or clearing is not configured",
    404: "there is no such thing",
    408: "the body did not come in time",
    413: "the body is too long",
    414: "path and query are too long",
    421: "asked under a name that is not this machine's",
    431: "too many headers",
    500: "this server has failed; or the store did not take it (code not-kept)",
    502: "the daemon's answer cannot be read",
    503: "the daemon does not answer, or too much is asked at once",
}
ALWAYS = (400, 403, 408, 413, 414, 421, 431, 500)
DAEMON = (502, 503)
NUMBER = {"type": "integer", "minimum": 0, "maximum": queries.LARGEST}
ANY = {"type": "object"}


def document(*, guarded: bool = False) -> Json:
    """Return the document; `guarded`: every request needs a token."""
    _, schemas = msgspec.json.schema_components([*RECORDS, *BODIES], ref_template="#/components/schemas/{name}")
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "faultline",
            "version": "1",
            "summary": "The fault memory, the records and live values of a vehicle.",
            "description": "docs/http.md says more. Fields may be added; a change of meaning changes the path.",
        },
        "paths": _paths(guarded),
        "components": {
            "schemas": {**schemas, "Record": {"anyOf": [_ref(each.__name__) for each in RECORDS]}},
            "responses": {str(status): _problem(status, text) for status, text in PROBLEMS.items()},
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    }


def _paths(guarded: bool) -> Json:
    system = _parameter("system", "path", {"type": "string", "pattern": queries.SYSTEM}, "the name of a system", "uds")
    code = _parameter("code", "path", {"type": "string", "pattern": queries.CODE}, "the number of a fault", "3")
    faults, fault = "/v1/components/{system}/faults", "/v1/components/{system}/faults/{code}"

    def get(name: str, text: str, answer: Json, parameters: Sequence[Json] = (), more: Sequence[int] = DAEMON) -> Json:
        return {"get": _operation(name, text, {"200": answer}, parameters, more, guarded=guarded)}

    def delete(name: str, text: str, parameters: Sequence[Json]) -> Json:
        answers = {"204": {"description": "erased, and that is on the disk"}}
        return {"delete": _operation(name, text, answers, parameters, (404, *DAEMON), guarded=True)}

    health = get("health", "How the daemon is.", _body("HealthBody", "it can tell"), more=())
    health["get"]["responses"]["503"] = _body("HealthBody", "silence does not mean that nothing is wrong")
    return {
        "/v1/components": get("components", "The watched systems.", _body("Components")),
        "/v1/components/{system}": get("component", "One of them.", _body("Capabilities"), [system], (404, *DAEMON)),
        faults: {
            **get("faults", "What is remembered of it.", _body("Items"), [system, *_filters()], (404, *DAEMON)),
            **delete("clearAll", "Erases all that is remembered of it.", [system]),
        },
        fault: {
            **get("fault", "One fault.", _body("Detail"), [system, code, *_parts()], (404, *DAEMON)),
            **delete("clear", "Erases it.", [system, code]),
        },
        "/v1/systems/{system}": get("system", "What its names mean.", _json(ANY), [system], (404, *DAEMON)),
        "/v1/live/{system}": get("live", "Its ticks as they come.", _stream(), [system], (404, *DAEMON)),
        "/v1/history/{system}": get(
            "history", "The ticks of a finished recording.", _json(ANY), [system, *_ticks()], (404, *DAEMON)
        ),
        "/v1/events": get("events", "All that is told, as it is told.", _stream(), _places(), (503,)),
        "/v1/records": get("records", "What was told.", _records(), _pages()),
        "/v1/health": health,
        "/v1/state": get("state", "The same, as 200 in any case.", _body("HealthBody"), more=()),
        "/v1/ready": get("ready", "Whether the daemon answers.", _body("Ready")),
        "/v1/openapi.json": get("document", "This.", _json(ANY), more=()),
        "/metrics": get(
            "metrics", "Figures for Prometheus.", _content(metrics.CONTENT_TYPE, {"type": "string"}), more=()
        ),
    }


def _operation(
    name: str, text: str, answers: Mapping[str, Json], parameters: Sequence[Json], more: Sequence[int], *, guarded: bool
) -> Json:
    problems = sorted({*ALWAYS, *more, *((401,) if guarded else ())})
    return {
        "operationId": name,
        "summary": text,
        "parameters": [*parameters],
        "responses": {**answers, **{str(each): {"$ref": f"#/components/responses/{each}"} for each in problems}},
        **({"security": [{"token": []}]} if guarded else {}),
    }


def _filters() -> list[Json]:
    bits: Json = {"type": "string", "enum": [*queries.BOOLEANS]}
    word: Json = {"type": "string", "enum": [*AGGREGATED]}
    text = "faults with this, or with another status that is asked for; in any case of letters"
    return [
        *(_parameter(f"status[{key}]", "query", bits, text) for key in STATUS_KEYS),
        _parameter("status[aggregatedStatus]", "query", word, text),
        _parameter("severity", "query", {"type": "integer", "minimum": 1, "maximum": 4}, "faults of this severity"),
        _parameter("scope", "query", {"type": "string", "pattern": queries.SCOPE}, "faults of this memory"),
    ]


def _parts() -> list[Json]:
    flag = {"type": "string", "enum": [*queries.BOOLEANS], "default": "true"}
    return [
        _parameter("include-extended-data", "query", flag, "counts and what showed it"),
        _parameter("include-snapshot-data", "query", flag, "freeze frames"),
    ]


def _places() -> list[Json]:
    name = {"type": "string", "pattern": queries.ID}
    return [
        _parameter("after", "query", {"anyOf": [NUMBER, name]}, "begin after this record: its number or id"),
        _parameter("Last-Event-ID", "header", name, "the same, as a browser says it; it counts before `after`"),
    ]


def _pages() -> list[Json]:
    count = {"type": "integer", "minimum": 1, "maximum": queries.MOST, "default": 100}
    return [
        _parameter("after", "query", NUMBER, "the ones after this number, the oldest first"),
        _parameter("before", "query", NUMBER, "the last before it; with `after`, the first between; else the latest"),
        _parameter("count", "query", count, "at most so many"),
    ]


def _ticks() -> list[Json]:
    count = {"type": "integer", "minimum": 1, "maximum": queries.MOST_TICKS, "default": 2000}
    return [
        _parameter("after", "query", NUMBER, "the ticks after this one"),
        _parameter("before", "query", NUMBER, "the ticks before this one"),
        _parameter("count", "query", count, "at most so many, the telling one of each few"),
    ]


def _parameter(name: str, place: str, schema: Json, text: str, example: str | None = None) -> Json:
    more = {} if example is None else {"example": example}
    return {"name": name, "in": place, "required": place == "path", "schema": schema, "description": text, **more}


def _records() -> Json:
    many = {"type": "array", "items": _ref("Record"), "maxItems": queries.MOST}
    return _json({"type": "object", "properties": {"records": many}, "required": ["records"]})


def _body(name: str, text: str = "the answer") -> Json:
    return _content("application/json", _ref(name), text)


def _json(schema: Json) -> Json:
    return _content("application/json", schema)


def _stream() -> Json:
    text = "Server-Sent Events: `event` is the kind of record (or `live`), `id` its id, `data` the record"
    return _content("text/event-stream; charset=utf-8", {"type": "string"}, text)


def _problem(status: int, text: str) -> Json:
    answer = _content(MEDIA_TYPE, _ref("Problem"), text)
    if status in (401, 503):
        name, meaning = ("WWW-Authenticate", "Bearer") if status == 401 else ("Retry-After", "seconds")
        answer["headers"] = {name: {"schema": {"type": "string"}, "description": meaning, "required": True}}
    return answer


def _content(media_type: str, schema: Json, text: str = "the answer") -> Json:
    return {"description": text, "content": {media_type: {"schema": schema}}}


def _ref(name: str) -> Json:
    return {"$ref": f"#/components/schemas/{name}"}
