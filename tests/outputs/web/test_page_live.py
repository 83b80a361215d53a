"""The page of a running service, in a real browser: values as they come, an alarm, a service that goes away."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from ports import multicast
from web_browser import Vehicle, browser, page
from web_server import TOKEN, serving

SPEED = 10.0


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as started:
        yield started


def test_a_live_alarm_its_history_and_its_end(chromium: Browser, tmp_path: Path) -> None:
    tokens = tmp_path / "tokens"
    tokens.write_text(TOKEN)
    tokens.chmod(0o600)
    refused: list[int] = []
    with Vehicle(tmp_path, multicast(), SPEED) as vehicle:
        places = ("--control", str(vehicle.control), "--events", str(vehicle.events), "--token-file", str(tokens))
        with (
            serving(*places, "--listen", "127.0.0.1:0", log=tmp_path / "serve.log", orderly=True) as running,
            page(chromium, running.url, refused) as opened,
        ):
            verdict, more = opened.locator("#verdict"), opened.locator("#verdict-more")
            expect(verdict).to_have_attribute("data-kind", "cannot-tell")  # silence is not "no fault"
            vehicle.play()
            expect(opened.locator("#connection")).to_have_text("live")
            expect(opened.locator("#source")).to_have_text("truck-17")
            expect(opened.locator('#tests tr[data-verdict="alarm"]').first).to_be_visible()  # ends with the recording
            expect(verdict).to_have_attribute("data-kind", "fault")
            expect(opened.locator("#diagnoses li").first).to_be_visible()
            expect(opened.locator("#records li", has_text="fault confirmed").first).to_be_visible()

            expect(opened.locator("#follow")).to_have_attribute("aria-pressed", "true")
            opened.locator("#at").focus()
            opened.keyboard.press("Home")
            expect(opened.locator("#follow")).to_have_attribute("aria-pressed", "false")
            expect(opened.locator("#verdict-text")).to_have_text(re.compile("^Now: Fault"))  # whatever is looked at
            expect(more).to_have_text(re.compile(r"^At \d:\d\d\.\d, which is shown: (?!Fault)"))
            opened.locator("#follow").press("Enter")
            expect(opened.locator("#follow")).to_have_attribute("aria-pressed", "true")

            fault = opened.locator("#faults details").first
            expect(fault.locator(".tag.active")).to_be_visible()
            fault.locator("summary").press("Enter")
            expect(fault.locator("table").first.locator("tbody tr")).to_have_count(5)

            refused.append(503)  # what the server answers from now on, and rightly
            vehicle.daemon.kill()
            expect(opened.locator("#connection")).to_have_text(re.compile("does not answer|no live values"))
            expect(verdict).to_have_attribute("data-kind", "cannot-tell")  # what stood last is not what is
            expect(more).to_contain_text("What stood last: Fault")
            vehicle.daemon.wait()
            vehicle.start()
            vehicle.play()
            expect(opened.locator("#connection")).to_have_text("live")
            expect(opened.locator("#records li", has_text="started").first).to_be_visible()


def test_erasing_takes_the_token(chromium: Browser, tmp_path: Path) -> None:
    tokens = tmp_path / "tokens"
    tokens.write_text(TOKEN)
    tokens.chmod(0o600)
    with Vehicle(tmp_path, multicast(), SPEED) as vehicle:
        vehicle.play()
        places = ("--control", str(vehicle.control), "--events", str(vehicle.events), "--token-file", str(tokens))
        with (
            serving(*places, "--listen", "127.0.0.1:0", log=tmp_path / "serve.log", orderly=True) as running,
            page(chromium, running.url, refused=(403, 404)) as opened,  # what is erased may be looked at just then
        ):
            fault = opened.locator('#faults details[data-code="1"]')
            expect(fault).to_be_visible()
            fault.locator("summary").press("Enter")
            fault.locator("form input").fill("wrong" * 8)
            fault.locator("form button").press("Enter")
            expect(fault.locator("form output")).to_have_text(re.compile("token"))
            fault.locator("form input").fill(TOKEN)
            fault.locator("form button").press("Enter")
            expect(opened.locator('#faults details[data-code="1"]')).to_have_count(0)
            expect(opened.locator("#records li", has_text="erased by").first).to_be_visible()
