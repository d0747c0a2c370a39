"""Take a picture of a part of a report for the docs: pictures.py PAGE SELECTOR NAME.

Needs Chromium and Playwright (the extra ``test``).
"""

import io
import shutil
import sys
from pathlib import Path

from PIL import Image

WIDTH, HEIGHT = 860, 900


def main(page: Path, part: str, picture: Path) -> None:
    """Take a picture of the element that a CSS selector finds.

    Replays are at their ends, and values of curves are read at three tenths of the steps.
    """
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        view = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT}, color_scheme="light")
        view.goto(page.resolve().as_uri())
        for slider in ("#moment", "#tick"):
            view.locator(slider).press("End")
        for _ in range(7):
            view.locator("#chart").press("PageDown")
        view.evaluate("document.activeElement.blur()")
        taken = Image.open(io.BytesIO(view.locator(part).screenshot()))
        taken.convert("RGB").save(picture, optimize=True)
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(__file__).with_name(sys.argv[3]))
