"""Write what is made of the messages: tables of their fields in docs/, and JSON Schema files beside this module.

Run as `python -m faultline.service.protocol.document docs`. A table stands in a page between `<!-- fields NAME -->`
and `<!-- end -->`, where NAME is that of the struct. Schemas are JSON Schema 2020-12; fields that they do not name are
allowed, as a newer version may send more.
"""

import re
import sys
from collections.abc import Iterable
from pathlib import Path

import msgspec
from msgspec import inspect

from faultline.service.core.display import Display
from faultline.service.core.records.context import SCHEMA as CONTEXT
from faultline.service.core.records.context import Context, LampStates, TroubleCode
from faultline.service.core.records.discrimination import Separation
from faultline.service.core.records.event import SCHEMA as EVENT
from faultline.service.core.records.event import Diagnosis, Event
from faultline.service.core.records.fault import CLEARED, Cleared, Dtc, Fault, FaultRecord, Seen, Status
from faultline.service.core.records.fault import SCHEMA as FAULT
from faultline.service.core.records.freeze_frame import SCHEMA as FRAME
from faultline.service.core.records.freeze_frame import Excerpt, FreezeFrame, Input, Verdict
from faultline.service.core.records.health import SCHEMA as HEALTH
from faultline.service.core.records.health import Health, Standing
from faultline.service.protocol.answers import (
    STATE,
    BaselineStatus,
    Begun,
    BusStatus,
    Erased,
    FaultDetail,
    FaultList,
    FreezeFrames,
    RecordPage,
    ServiceState,
    StoreStatus,
    SystemStatus,
)
from faultline.service.protocol.errors import ErrorAnswer, Refusal, Rejection
from faultline.service.protocol.live import (
    LIVE,
    DisturbanceMeaning,
    EquationMeaning,
    FaultMeaning,
    GeneratorMeaning,
    History,
    LiveTick,
    Signal,
    Stand,
    SystemDescription,
)
from faultline.service.protocol.questions import Question
from faultline.service.protocol.records import Subscription
from faultline.writing import write_file, write_files

Message = type[msgspec.Struct]

SENT: dict[str, Message] = {
    EVENT: Event,
    HEALTH: Health,
    FAULT: FaultRecord,
    CLEARED: Cleared,
    CONTEXT: Context,
    FRAME: FreezeFrame,
    LIVE: LiveTick,
    STATE: ServiceState,
}
"""Messages that say their schema, which have a file each."""

PARTS: tuple[Message, ...] = (
    *(LampStates, TroubleCode, Diagnosis, Fault, Status, Seen, Dtc, Standing, Input, Verdict, Excerpt, Separation),
    *(StoreStatus, BusStatus, SystemStatus, BaselineStatus, Signal, Display, GeneratorMeaning, FaultMeaning),
    *(EquationMeaning, DisturbanceMeaning, Stand, Refusal),
)
BESIDES: tuple[Message, ...] = (
    *(
        Subscription,
        Rejection,
        Question,
        FaultList,
        FaultDetail,
        FreezeFrames,
        Erased,
        Begun,
        RecordPage,
        SystemDescription,
    ),
    *(History, ErrorAnswer),
)
MESSAGES = (*SENT.values(), *PARTS, *BESIDES)
"""All structs that go over the two sockets."""

SCHEMAS = Path(__file__).with_name("schemas")
PAGES = ("events.md", "control.md")
_TABLE = re.compile(r"(?<=<!-- fields )(\w+)( -->\n).*?(?=<!-- end -->)", re.DOTALL)


def table(message: Message) -> str:
    """Return the rows of a message: field, type, meaning."""
    rows = [f"| `{field.encode_name}` | {_type(field.type)} | {_meaning(field.type)} |" for field in _fields(message)]
    return "\n".join(["| field | type | meaning |", "|---|---|---|", *rows, ""])


def documented(page: str) -> str:
    """Return the page with its tables as the messages are now; raises KeyError of a struct that is no message."""
    known = {message.__name__: message for message in MESSAGES}
    return _TABLE.sub(lambda found: f"{found[1]}{found[2]}{table(known[found[1]])}", page)


def schema(name: str) -> bytes:
    """Return the JSON Schema of messages whose field `schema` is `name`."""
    message = SENT[name]
    _, components = msgspec.json.schema_components([message], ref_template="#/$defs/{name}")
    own = components.pop(message.__name__)
    own["properties"]["schema"] = {"const": name}
    whole = {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": f"urn:{name.replace('/', ':')}", **own}
    return msgspec.json.format(msgspec.json.encode({**whole, "$defs": components}), indent=1) + b"\n"


def file_of(name: str) -> Path:
    """Return the file of a schema: `faultline.event/1` is event-1.json."""
    return SCHEMAS / f"{name.removeprefix('faultline.').replace('/', '-')}.json"


def undocumented(messages: Iterable[Message] = MESSAGES) -> list[str]:
    """Return the fields without a meaning."""
    return [f"{each.__name__}.{field.name}" for each in messages for field in _fields(each) if not _meaning(field.type)]


def _fields(message: Message) -> tuple[inspect.Field, ...]:
    described = inspect.type_info(message)
    assert isinstance(described, inspect.StructType)
    return described.fields


def _meaning(of: inspect.Type) -> str:
    """The description, which a type that is used often (`Number`) may wrap in another."""
    if not isinstance(of, inspect.Metadata):
        return ""
    return str((of.extra_json_schema or {}).get("description", "")) or _meaning(of.type)


def _type(of: inspect.Type) -> str:
    """A type in the words of JSON."""
    if isinstance(of, inspect.Metadata):
        return _type(of.type)
    if isinstance(of, inspect.UnionType):
        return " or ".join(sorted(map(_type, of.types), key=lambda word: word == "null"))
    if isinstance(of, inspect.ListType):
        return f"array of {_plural(_type(of.item_type))}"
    names = {
        inspect.StrType: "string",
        inspect.LiteralType: "string",
        inspect.BoolType: "boolean",
        inspect.IntType: "integer",
        inspect.FloatType: "number",
        inspect.NoneType: "null",
        inspect.RawType: "object",
        inspect.DictType: "object",
        inspect.StructType: "object",
    }
    return names[type(of)]


def _plural(words: str) -> str:
    if words.startswith("array of "):
        return words.replace("array", "arrays", 1)
    return " or ".join(f"{word}s" for word in words.split(" or "))


def main(argv: list[str]) -> int:
    """Write all of it; `argv` names the folder of the pages."""
    for page in (Path(argv[0]) / name for name in PAGES):
        write_file(page, documented(page.read_text()))
    write_files({file_of(name): schema(name) for name in SENT})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
