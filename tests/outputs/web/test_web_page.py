"""docs/http.md says what the code does."""

import re
from pathlib import Path

from test_web_metrics import STATE, strictly
from web_daemon import fault

from faultline.service.web import settings
from faultline.service.web.app import table
from faultline.service.web.health import BLINDING
from faultline.service.web.limits import Limits
from faultline.service.web.metrics import Counts, of_daemon, of_server, render
from faultline.service.web.problems import OF_DAEMON
from faultline.service.web.queries import MOST
from faultline.service.web.ring import SIZE
from faultline.service.web.routes import Routes
from faultline.service.web.tokens import CREDENTIAL, LEAST

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "http.md").read_text()


def section(heading: str) -> str:
    return PAGE.partition(f"## {heading}\n")[2].partition("\n## ")[0]


def named(text: str) -> set[str]:
    """What stands in backquotes in the first cells of a table."""
    return {name for row in re.findall(r"^\| (`.*?) \|", text, re.MULTILINE) for name in re.findall(r"`([^`]+)`", row)}


def test_names_every_path() -> None:
    paths = {route.path.replace(":path", "") for route in table(Routes.__new__(Routes))}
    assert named(section("What is asked")) == paths


def test_names_every_setting() -> None:
    keys = {*settings.Settings.__struct_fields__}
    assert named(PAGE.partition("## What is asked")[0]) == keys
    assert f"`{CREDENTIAL}`" in PAGE
    assert f"of {LEAST} characters or more" in PAGE


def test_names_every_code() -> None:
    source = "".join(path.read_text() for path in (ROOT / "service" / "web").glob("*.py"))
    raised = set(re.findall(r'(?:RequestError|RefusedError)\(\s*(?:\w+, )?"([a-z-]+)"', source))
    made = {"no-route", "method"}  # from Starlette's own
    assert named(section("Errors")) == raised | made | set(OF_DAEMON)


def test_names_every_figure_with_its_labels() -> None:
    counts = Counts()
    counts.requests["GET", 200] += 1
    counts.turned_away["no room"] += 1
    read = strictly(render([*of_daemon(STATE, [fault(1)]), *of_server(counts, subscribed=True)]))
    told = {name: {label for labels in one.samples for label, _ in labels} for name, one in read.items()}
    rows = re.findall(r"^\| (`faultline.*?) \| (.*?) \|", section("Figures"), re.MULTILINE)
    said = {
        name: set(re.findall(r"`(\w+)`", labels)) for names, labels in rows for name in re.findall(r"`(\w+)`", names)
    }
    assert said == told


def test_says_the_limits() -> None:
    limits, text = Limits(), section("Limits")
    assert f"| {limits.body // 1024} KiB, {limits.body_s:.0f} s |" in text
    assert f"| {limits.headers}, {limits.header_bytes // 1024} KiB |" in text
    assert f"| {limits.target // 1024} KiB |" in text
    assert f"| {limits.header_s:.0f} s ({limits.keep_alive_s} s without a byte) |" in text
    assert f"| {limits.held // 1024**2} MiB |" in text
    assert f"| connections | {limits.connections} |" in text
    assert f"| {limits.stalled_s:.0f} s |" in text
    assert f"| {limits.answer_s:.0f} s, {limits.clear_s:.0f} s to erase |" in text
    streams = section("Streams")
    assert f"every {limits.alive_s:.0f} s" in streams
    assert f"nothing for {limits.stalled_s:.0f} s, or falls {SIZE} records behind" in streams
    assert f"There are {limits.streams} streams at most" in streams
    assert f"{MOST} at most" in section("What is asked")


def test_says_what_blinds() -> None:
    text = section("What is asked").partition("*blind* by")[2]
    assert set(re.findall(r"`([a-z-]+)`", text)) == BLINDING
