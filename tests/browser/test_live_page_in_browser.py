"""The live page of a run in a browser: it follows the units, and a reader's place stays."""

from concurrent.futures import ThreadPoolExecutor
from threading import Event, Semaphore, Thread

import pytest

from curricle.report import live_server, live_study
from curricle.report.live_server import live_run
from curricle.study import read_study, run_study
from tests.studies import HUNT

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

PHONE, DESK = {"width": 390, "height": 844}, {"width": 1300, "height": 900}
UNITS = 6


class Paced(ThreadPoolExecutor):
    """One thread, which trains a unit when a test says so."""

    def __init__(self):
        super().__init__(1)
        self.allowed = Semaphore(0)

    def submit(self, function, /, *given):
        def when_allowed():
            self.allowed.acquire()
            return function(*given)

        return super().submit(when_allowed)


@pytest.fixture
def run(tmp_path, monkeypatch):
    """A run whose units wait until they are allowed, and the address of its page."""
    monkeypatch.setattr(live_study, "BETWEEN", 0.05)
    monkeypatch.setattr(live_study, "SHARE", 1e9)
    monkeypatch.setattr(live_server, "TICK", 0.05)
    file = tmp_path / "hunt.toml"
    file.write_text(HUNT, "utf-8")
    executor, served, address = Paced(), Event(), []

    def train():
        line = "{} of {} units".format
        with live_run(tmp_path / "out", line) as server, executor:
            address.append(server.address)
            served.set()
            run_study(read_study(file), tmp_path / "out", executor=executor)

    thread = Thread(target=train)
    thread.start()
    served.wait()
    executor.address = address[0]
    yield executor
    executor.allowed.release(UNITS)
    thread.join()


@pytest.fixture
def visit(browser, run):
    """Opens the page; it must log nothing and ask nobody but the run."""
    contexts, heard = [], []

    def open_page(viewport):
        contexts.append(browser.new_context(viewport=viewport))
        page = contexts[-1].new_page()
        page.on("console", lambda message: heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.on(
            "request",
            lambda r: None if r.url.startswith((run.address, "data:")) else heard.append(r.url),
        )
        page.goto(run.address)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert heard == []


def says(page, selector, words):
    sync_api.expect(page.locator(selector)).to_contain_text(words, timeout=60_000)


def fits(page):
    return page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def ticks_of(page):
    """The steps that the curves' axis names."""
    return page.locator("#chart > text[text-anchor='middle']").all_text_contents()


def test_the_page_follows_the_units_and_keeps_the_last_report(run, visit):
    page, phone = visit(DESK), visit(PHONE)
    says(page, "#line", "0 of 6 units")
    run.allowed.release(2)  # scratch
    says(page, "#rows li >> nth=0", "4 of 4 seeds; return")
    says(page, "#note", "The report begins when scratch and another arm have finished a seed.")
    assert page.locator("#rows polyline").count() == 1
    assert fits(page)
    assert fits(phone)
    run.allowed.release(3)  # the sources, and two seeds of the target
    says(page, "#report", "2 seeds")
    assert page.locator("h1:visible").all_text_contents() == ["hunt"]
    assert page.locator("#report .live").is_visible()  # the report's own script has begun
    says(phone, "#report", "2 seeds")
    assert fits(phone)

    page.get_by_text("What the columns mean").click()
    page.get_by_label("No: weak transfer").check()
    arm = page.locator("#arms li", has_text="scratch").get_by_role("button")
    arm.click()
    page.get_by_role("button", name="Zoom in").click()
    zoomed = ticks_of(page)
    page.locator("#run").scroll_into_view_if_needed()
    place = "document.querySelector('#run').getBoundingClientRect().top"
    before = page.evaluate(place)
    phone.get_by_label("Keep the report as it is").check()
    run.allowed.release(1)
    says(page, "#ended", "The run has ended.")
    says(page, "#report", "4 seeds")
    assert page.get_by_text("What the columns mean").locator("..").get_attribute("open") == ""
    assert page.locator(".curves.weak").is_visible()
    assert arm.get_attribute("aria-pressed") == "false"
    assert ticks_of(page) == zoomed
    assert page.locator("#chart-reset").is_enabled()
    assert page.evaluate(place) == pytest.approx(before, abs=2)
    assert page.locator("#report footer").count() == 0
    assert page.title() == "Ended · hunt"

    says(phone, "#ended", "The run has ended.")
    says(phone, "#report", "2 seeds")
    phone.get_by_label("Keep the report as it is").uncheck()
    says(phone, "#report", "4 seeds")
    assert fits(phone)
