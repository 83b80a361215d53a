"""Pictures of the page for docs/, of the golden recording in a real browser.

python tests/campaigns/screenshots.py docs
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import expect

sys.path += [str(Path(__file__).resolve().parents[1] / "outputs" / "web")]
from web_browser import PHONE, browser, page, recorded

WIDE = {"width": 1280, "height": 1130}


def main(folder: Path) -> None:
    """Writes page.png and page-phone.png."""
    with TemporaryDirectory() as place, recorded(Path(place)) as url, browser() as chromium:
        with page(chromium, url, viewport=WIDE) as opened:
            opened.locator("#records button", has_text=":").first.click()
            expect(opened.locator("#verdict")).to_have_attribute("data-kind", "fault")
            opened.evaluate("scrollTo(0, 0)")
            opened.screenshot(path=folder / "page.png")
        with page(chromium, url, viewport={**PHONE, "height": 1100}, color_scheme="dark") as opened:
            expect(opened.locator("#verdict")).to_have_attribute("data-kind", "fault")
            opened.screenshot(path=folder / "page-phone.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
