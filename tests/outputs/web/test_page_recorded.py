"""The page of a finished recording, in a real browser: verdict, matrix, freeze frames, keyboard, phone, colours."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from web_browser import GOLDEN, PHONE, browser, page, recorded

EVENTS = [json.loads(line) for line in (GOLDEN / "events.jsonl").read_text().splitlines()]
FIRED = next(event for event in EVENTS if event["transition"] == "occurred")
TRUE = FIRED["diagnoses"][0]["faults"]
LIGHT, DARK = "rgb(246, 247, 248)", "rgb(16, 22, 27)"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with recorded(tmp_path_factory.mktemp("recorded")) as where:
        yield where


def test_says_the_verdict_of_the_recording(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        expect(opened.locator("#connection")).to_have_text("finished recording")
        expect(opened.locator("#source")).to_contain_text("recording")
        last = EVENTS[-1]["diagnoses"]
        expect(opened.locator("#diagnoses li")).to_have_count(len(last))
        expect(opened.locator("#verdict")).to_have_attribute("data-kind", "fault")
        assert re.match(r"At \d:\d\d\.\d: Fault: ", opened.title())
        expect(opened.locator("#verdict-more")).to_contain_text("Confirmed in what is shown of this drive")
        expect(opened.locator("#verdict-more")).to_contain_text(", ".join(EVENTS[-1]["alarm"]))


def test_the_matrix_lights_up_as_time_goes_on(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        rows = opened.locator("#tests tbody tr")
        expect(rows.first).to_be_visible()
        alarms = opened.locator('#tests tr[data-verdict="alarm"]')
        opened.locator("#records li", has_text="fault confirmed").locator("button").press("Enter")
        expect(alarms).to_have_count(len(FIRED["alarm"]))
        assert {*alarms.locator("th button").all_text_contents()} == {*FIRED["alarm"]}
        opened.keyboard.press("End")
        expect(opened.locator("#tests td.cell.sensitive").first).to_contain_text(re.compile("sensitive"))
        heads = opened.locator("#tests th.candidate")
        expect(heads).to_have_count(len({name for each in EVENTS[-1]["diagnoses"] for name in each["faults"]}))
        opened.locator("#at").focus()
        opened.keyboard.press("Home")  # before anything was known
        expect(opened.locator("#tests th.candidate")).to_have_count(0)
        expect(opened.locator("#verdict")).not_to_have_attribute("data-kind", "fault")
        opened.keyboard.press("End")
        expect(opened.locator("#verdict")).to_have_attribute("data-kind", "fault")


def test_a_record_leads_to_its_time(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        told = opened.locator("#records li", has_text="fault confirmed").locator("button")
        clock = f"{int(FIRED['t_s'] // 60)}:{FIRED['t_s'] % 60:04.1f}"
        expect(told).to_have_text(clock)
        told.press("Enter")
        expect(opened.locator("#at-text")).to_contain_text(clock)
        expect(opened.locator("#verdict")).to_have_attribute("data-kind", "fault")
        said = re.compile(f"^{re.escape(clock)} into the drive")
        expect(opened.locator("#at")).to_have_attribute("aria-valuetext", said)


def test_a_test_is_chosen_by_the_keyboard(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        button = opened.locator("#tests tbody button").nth(5)
        name = button.text_content()
        button.focus()
        opened.keyboard.press("Space")
        expect(button).to_have_attribute("aria-pressed", "true")
        expect(opened.locator("#test-title")).to_have_text(f"Residual and CUSUM of {name}")
        charts = opened.locator("#test-charts [role=img]")
        expect(charts.first).to_have_attribute("aria-label", re.compile(f"^Residual of {name}"))
        said = re.compile("parts of its threshold: .*: (alarm|quiet|cannot tell)$")
        expect(charts.nth(1)).to_have_attribute("aria-label", said)


def test_charts_say_in_words_what_they_draw(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        labels = opened.locator("#signal-charts [role=img]")
        expect(labels).to_have_count(5)
        expect(labels.last).to_have_attribute("aria-label", re.compile("measured"))
        said = [labels.nth(k).get_attribute("aria-label") or "" for k in range(5)]
        pressures = [label for label in said if "predicted" in label]
        assert len(pressures) == 3
        assert all(re.search(r"measured -?[\d.]+ bar, predicted -?[\d.]+ bar by t\d\d", label) for label in pressures)
        drawn = opened.evaluate(
            """() => [...document.querySelectorAll('#signals canvas')].map((canvas) => {
                 const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
                 return new Set(data.filter((_, k) => k % 4 === 3)).size > 1; })"""
        )
        assert drawn == [True] * 5


def test_the_history_has_freeze_frames(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        fault = opened.locator("#faults details").first
        fault.locator("summary").press("Enter")
        expect(fault.locator("h3").first).to_have_text("Freeze frame, when it was told first")
        expect(fault.locator("table").first.locator("tbody tr")).to_have_count(5)
        expect(fault.locator(".uplot")).to_have_count(2)
        expect(fault.locator("form")).to_have_count(0)  # nothing of a recording can be erased
        expect(fault.locator("table").nth(1)).to_contain_text("alarm")


@pytest.mark.parametrize(("scheme", "paper"), [("light", LIGHT), ("dark", DARK)])
def test_fits_a_phone_in_light_and_dark(chromium: Browser, url: str, scheme: str, paper: str) -> None:
    with page(chromium, url, viewport=PHONE, color_scheme=scheme, has_touch=True) as opened:
        expect(opened.locator("#diagnoses li").first).to_be_visible()
        opened.locator("#faults summary").first.tap()
        expect(opened.locator("#faults table").first).to_be_visible()
        assert opened.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
        assert opened.evaluate("getComputedStyle(document.documentElement).backgroundColor") == paper
        small = opened.evaluate(
            "() => [...document.querySelectorAll('button, select, summary')].filter((e) => e.offsetParent && "
            "e.getBoundingClientRect().height < 24).map((e) => e.outerHTML)"
        )
        assert small == []  # WCAG 2.2, target size


def test_asks_for_the_part_that_is_wanted(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        expect(opened.locator("#diagnoses li").first).to_be_visible()
        opened.locator("#window").select_option("60")
        most = re.compile(r"^[12]?\d?\d$")  # 60 s at 5 a second are 300
        expect(opened.locator("#at")).to_have_attribute("max", most)
        expect(opened.locator("#verdict")).to_have_attribute("data-kind", "fault")


def test_every_way_in_has_a_name(chromium: Browser, url: str) -> None:
    with page(chromium, url) as opened:
        expect(opened.locator("#diagnoses li").first).to_be_visible()
        nameless = opened.evaluate(
            """() => [...document.querySelectorAll('button, select, input, a, [role], section')].filter((e) => {
                 const by = (e.getAttribute('aria-labelledby') ?? '').split(' ')
                   .map((id) => document.getElementById(id));
                 const text = [e.textContent, e.getAttribute('aria-label'), e.closest('label')?.textContent,
                               ...by.map((each) => each?.textContent)];
                 return !text.some((each) => each && each.trim()); }).map((e) => e.outerHTML)"""
        )
        assert nameless == []
        assert opened.locator("h1").count() == 1
        opened.keyboard.press("Tab")
        expect(opened.locator(".skip")).to_be_focused()
        opened.keyboard.press("Enter")
        expect(opened.locator("#explanations")).to_be_focused()


def test_no_text_that_is_told_is_markup() -> None:
    """Elements are made, never parsed: what a bundle or a vehicle is called cannot be a script."""
    folder = Path(__file__).parents[3] / "service" / "web" / "page"
    for path in folder.glob("*.js"):
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b", path.read_text()), path
