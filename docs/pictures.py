"""Take the documentation's pictures of reports: pictures.py [PAGE SELECTOR NAME].

Without arguments the studies of PAGES are run in a temporary folder, as these pages say, and all
PICTURES are taken of their reports. Needs Chromium and Playwright (the extra ``test``).
"""

import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent))

from tests.walk import walk  # noqa: E402 (found where the line above has Python look)

PAGES = ("tutorial.md", "howto/bring_a_task.md")
PICTURES = {
    "report_watch.png": ("maze-results", "#watch .viewer"),
    "report_findings.png": ("vault-results", "#findings"),
    "report_curves.png": ("vault-results", "#curves .answers"),
}
"""Of which study of the pages, and of what part of its report."""
WIDTH, HEIGHT = 860, 900


def of_pages() -> None:
    """Do what the pages say, and take all pictures of the reports of their studies."""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as place:
        folder, variables = Path(place), {**os.environ, "PATH": programs}
        how = {"timed": False, "taken": lambda line: line.startswith("curricle ")}
        for page in PAGES:
            walk(HERE / page, folder, variables, **how)
        for name, (study, part) in PICTURES.items():
            subprocess.run(["curricle", "report", study], cwd=folder, env=variables, check=True)
            take(folder / study / "report.html", part, HERE / name)


def take(page: Path, part: str, picture: Path) -> None:
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
    if len(sys.argv) == 1:
        of_pages()
    else:
        take(Path(sys.argv[1]), sys.argv[2], HERE / sys.argv[3])
