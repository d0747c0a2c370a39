"""The page of a study in a browser: by mouse and keyboard, on a phone, on paper, offline."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import curricle as cr
from curricle.design.recipe_design import design_recipe
from curricle.learning.record import Snapshots
from curricle.report.design_report import write_design_report
from curricle.report.page import study_page
from curricle.tasks import maze_family

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
QUIET = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
PAPER = {"width": 688, "height": 1000}  # what A4 leaves between its margins
PHONE, DESK = {"width": 360, "height": 740}, {"width": 1200, "height": 900}
ODD = "<img src=x onerror=alert(1)>&\"' "
SHOWN = "e => e.getClientRects().length > 0"

pytestmark = pytest.mark.skipif(not CHROMIUM, reason="there is no Chromium on the path")


def kept_snapshots(task, budget, name, phi=None):
    """Three moments of training, each a training of its own."""
    steps = np.array([0, budget // 2, budget])
    first = np.zeros((task.states.size, task.actions.size)) if phi is None else phi.values
    later = [
        cr.learn(
            task, None, int(n), shaping=cr.QInitialisation(phi), eval_freq=int(n), stream=name
        ).values[0]
        for n in steps[1:]
    ]
    return Snapshots(0, steps, np.array([first, *later], dtype=np.float32))


def page_of(title, plan):
    """The page of one curriculum against its target alone."""
    comparison = cr.compare({f"{title} arm": plan}, seeds=3)
    target = plan.target
    scratch = cr.Curriculum({target: plan.tasks[target]}, budget=comparison.total)
    results = {"scratch": scratch.train(3), f"{title} arm": plan.train(3)}
    for arm, result in results.items():
        nodes = {}
        for name, node in result.nodes.items():
            phi = (result.potentials[name] or [None])[0]
            kept = kept_snapshots(node.task, int(node.steps_used[0]), name, phi)
            nodes[name] = replace(node, snapshots=kept)
        results[arm] = replace(result, nodes=nodes)
    return study_page(title, comparison, results)


def hunt():
    two, one = (cr.Pursuit(3, n, discount=0.9, time_limit=25) for n in (2, 1))
    names = two.predator_names
    return cr.Curriculum(
        {"chase": one, "hunt": two},
        [cr.Transfer("chase", "hunt", cr.project(two, one, predator=name)) for name in names],
        budget={"chase": 3000, "hunt": 6000},
    )


def maze():
    whole = cr.GridWorld(["......T", ".PP....", "F......", "S.#...."], time_limit=40)
    corner = whole.crop(rows=(0, 3), columns=(3, 7))
    return cr.Curriculum(
        {"corner": corner, "maze": whole},
        [cr.Transfer("corner", "maze", cr.same_position(whole, corner))],
        budget={"corner": 500, "maze": 3000},
    )


def chain():
    def line(n):
        rows = [[[(1.0, max(s - 1, 0), -1.0)], [(1.0, s + 1, -1.0)]] for s in range(n - 1)]
        ended = [False] * (n - 1) + [True]
        return cr.FiniteMDP.from_outcomes(
            [*rows, [[], []]], terminal=ended, start=0, discount=0.9, time_limit=25
        )

    long, short = line(9), line(5)
    f = cr.from_function(long, short, lambda s, a: ({"state": s["state"] - 4}, a))
    return cr.Curriculum(
        {f"{ODD} short": short, f"{ODD} long": long},
        [cr.Transfer(f"{ODD} short", f"{ODD} long", f)],
        budget={f"{ODD} short": 300, f"{ODD} long": 1500},
    )


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder, found = tmp_path_factory.mktemp("pages"), {}
    for name, title, plan in (
        ("hunt", "hunt", hunt()),
        ("maze", "maze", maze()),
        ("chain", ODD, chain()),
    ):
        found[name] = folder / f"{name}.html"
        found[name].write_text(page_of(title, plan), "utf-8")
    return found


@pytest.fixture(scope="module")
def design_file(files):
    """The page of a design is among the files."""
    members = [maze_family(size=n, pits=0.2, seed=3) for n in (4, 5)]
    problems = [cr.design.Problem(one, steps=20_000, miniature=True) for one in members]
    found = design_recipe(problems, cr.design.SearchBudget(700_000))
    first = replace(found.races[0], rounds=(found.races[0].rounds * 6)[:6])
    found = replace(found, races=(first, *found.races[1:]))
    files["design"] = write_design_report(found, files["maze"].with_name("recipe.html"))


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield launched
        launched.close()


@pytest.fixture
def visit(browser, files):
    """Opens a page; at the end of the test it must have logged and requested nothing."""
    contexts, heard = [], []

    def open_page(name, viewport=DESK, **settings):
        context = browser.new_context(viewport=viewport, **settings)
        contexts.append(context)
        page = context.new_page()
        address = files[name].as_uri()
        page.on("console", lambda message: heard.append(message.text))
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.on("dialog", lambda dialog: heard.append(dialog.message))
        page.on(
            "request", lambda r: heard.append(r.url) if r.url not in (address, "data:,") else None
        )
        page.clock.install(time=0)
        page.goto(address)
        page.clock.pause_at(3600)  # from here on time passes only when a test advances it
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert heard == []


def drawn(page, selector):
    """What a map shows: its coloured cells, its arrows or words, its numbers."""
    return page.eval_on_selector(
        selector,
        """svg => ({
            heat: Object.fromEntries([...svg.querySelectorAll(".heat path")]
                .map(path => [path.getAttribute("fill"), path.getAttribute("d")])
                .filter(([, d]) => d)),
            choice: svg.querySelector(".choice").getAttribute("d"),
            words: [...svg.querySelectorAll(".words text")].map(text => text.textContent),
            numbers: [...svg.querySelectorAll(".numbers text")].map(text => text.textContent),
        })""",
    )


def set_moment(page, place):
    page.locator("#moment").evaluate(
        "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); }", place
    )


def tab_to(page, name):
    """Press the tabulator until this element has the focus."""
    for _ in range(80):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == name:
            return
    raise AssertionError(f"the keyboard never reaches {name}")


def visible(page, selector):
    return [page.evaluate(SHOWN, one) for one in page.query_selector_all(selector)]


# -- values while learning went ------------------------------------------------------------------


@pytest.mark.parametrize("name", ["hunt", "maze", "chain"])
def test_the_script_draws_what_the_page_was_written_with(visit, name):
    page = visit(name)
    keys = page.eval_on_selector_all("#which option", "all => all.map(one => one.value)")
    assert len(keys) == 3
    for key in keys:
        page.select_option("#which", key)
        for place in range(3):
            set_moment(page, place)
            still = f'.still[data-key="{key}"] .moments figure:nth-child({place + 1})'
            assert drawn(page, "#map svg") == drawn(page, f"{still} svg")
            step = page.text_content(f"{still} figcaption").removeprefix("step ")
            assert page.text_content("#moment-words").startswith(f"Step {step} of ")


def test_the_slider_changes_map_and_label(visit):
    page = visit("maze")
    last, words = drawn(page, "#map svg"), page.text_content("#moment-words")
    set_moment(page, 0)
    assert drawn(page, "#map svg")["heat"] != last["heat"]
    assert drawn(page, "#map svg")["choice"] != last["choice"]
    assert page.text_content("#moment-words") != words
    assert page.get_attribute("#moment", "aria-valuetext") == page.text_content("#moment-words")


def test_playing_the_training_goes_to_its_end(visit):
    page = visit("maze")
    page.click("#map-play")
    assert page.text_content("#map-play") == "Pause"
    assert page.input_value("#moment") == "0"
    page.clock.run_for(200)
    assert page.input_value("#moment") == "1"
    page.clock.run_for(1000)
    assert page.input_value("#moment") == "2"
    assert page.text_content("#map-play") == "Play"


def test_another_replay_has_its_own_grid(visit):
    page = visit("hunt")
    assert page.locator("#map .fixed").count() == 2  # the prey and the other predator
    chase = page.eval_on_selector_all(
        "#which option", "all => all.find(one => one.textContent.startsWith('chase')).value"
    )
    page.select_option("#which", chase)
    assert page.locator("#map .fixed").count() == 1
    assert page.locator("#before .marker").count() == 2


# -- episodes ------------------------------------------------------------------------------------


def places(page):
    return page.eval_on_selector_all(
        "#before .marker, #after .marker", "all => all.map(one => one.style.transform)"
    )


def test_the_animation_plays_pauses_and_ends(visit):
    page = visit("maze")
    start, most = places(page), int(page.get_attribute("#tick", "max"))
    page.click("#episode-play")
    page.clock.run_for(1500)
    moved = int(page.input_value("#tick"))
    assert 0 < moved < most
    assert places(page) != start
    assert page.text_content("#episode-play") == "Pause"
    page.click("#episode-play")
    held = places(page)
    page.clock.run_for(5000)
    assert int(page.input_value("#tick")) == moved
    assert places(page) == held
    page.click("#episode-play")
    page.clock.run_for(60_000)
    assert int(page.input_value("#tick")) == most
    assert page.text_content("#episode-play") == "Play"
    outcomes = page.locator("#episodes .outcome").all_text_contents()
    key = page.input_value("#which")
    assert outcomes == page.locator(f'.still[data-key="{key}"] .outcome').all_text_contents()


def test_an_ended_episode_begins_again_when_played(visit):
    page = visit("maze")
    start = places(page)
    page.click("#episode-play")
    page.clock.run_for(60_000)
    page.click("#episode-play")
    assert page.input_value("#tick") == "0"
    assert places(page) == start


def test_moving_the_slider_pauses(visit):
    page = visit("hunt")
    page.click("#episode-play")
    page.locator("#tick").evaluate("e => { e.value = 2; e.dispatchEvent(new Event('input')); }")
    page.clock.run_for(5000)
    assert page.input_value("#tick") == "2"
    assert page.text_content("#episode-play") == "Play"


def test_nothing_glides_where_motion_is_unwelcome(visit):
    glide = "e => getComputedStyle(e).transitionDuration"
    assert visit("maze").locator("#after .marker").first.evaluate(glide) != "0s"
    calm = visit("maze", reduced_motion="reduce")
    assert calm.locator("#after .marker").first.evaluate(glide) == "0s"


# -- curves --------------------------------------------------------------------------------------


def test_the_switch_changes_the_axis(visit):
    page = visit("maze")
    assert visible(page, ".curves") == [True, False]
    page.get_by_label("No: weak transfer").check()
    assert visible(page, ".curves") == [False, True]
    page.get_by_label("Yes: strong transfer").check()
    assert visible(page, ".curves") == [True, False]


@pytest.mark.parametrize(("viewport", "shown"), [(DESK, [True, False]), (PHONE, [False, True])])
def test_each_width_has_its_own_curves(visit, viewport, shown):
    page = visit("maze", viewport)
    assert visible(page, ".strong > div") == shown


def test_the_keyboard_alone_does_all(visit):
    page = visit("maze")
    tab_to(page, "axis-strong")
    page.keyboard.press("ArrowDown")
    assert visible(page, ".curves") == [False, True]
    tab_to(page, "which")
    first = page.input_value("#which")
    page.keyboard.press("ArrowDown")
    assert page.input_value("#which") != first
    tab_to(page, "moment")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    last = drawn(page, "#map svg")
    page.keyboard.press("Home")
    assert drawn(page, "#map svg") != last
    assert page.text_content("#moment-words").startswith("Step 0 of ")
    tab_to(page, "episode-play")
    page.keyboard.press("Space")
    page.clock.run_for(1000)
    assert int(page.input_value("#tick")) > 0


# -- everywhere ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["hunt", "maze", "chain"])
def test_nothing_is_wider_than_a_phone_or_than_paper(visit, name):
    page = visit(name, PHONE)
    assert page.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
    table = page.locator("#measures .across")
    assert table.evaluate("e => e.scrollWidth > e.clientWidth")  # it scrolls inside
    page.set_viewport_size(PAPER)
    page.emulate_media(media="print")
    assert page.evaluate("document.documentElement.scrollWidth") == PAPER["width"]


def test_words_on_a_phone_are_large_enough(visit):
    page = visit("hunt", PHONE)
    sizes = page.eval_on_selector_all(
        "p, li, td, th, figcaption, .curves .narrow text",
        """all => all.filter(e => e.getClientRects().length && e.textContent.trim()).map(e => {
            const m = e.ownerSVGElement ? e.getScreenCTM() : { a: 1, b: 0 };
            return Math.hypot(m.a, m.b) * parseFloat(getComputedStyle(e).fontSize);
        })""",
    )
    assert min(sizes) >= 9.5


@pytest.mark.usefixtures("design_file")
def test_a_design_fits_a_phone_a_desk_and_paper(visit):
    page = visit("design", PHONE)
    for size, viewport in (("narrow", PHONE), ("wide", DESK)):
        page.set_viewport_size(viewport)
        assert page.evaluate("document.documentElement.scrollWidth") == viewport["width"]
        assert visible(page, f".scatter .{size}") == [True]
        assert sorted(visible(page, ".scatter > div")) == [False, True]
        inside = """all => all.every(e => {
            const own = e.getBoundingClientRect(), around = e.closest("td").getBoundingClientRect();
            return own.right <= around.right + 1;
        })"""
        assert page.eval_on_selector_all(".bracket td span", inside)
    page.set_viewport_size(PAPER)
    page.emulate_media(media="print")
    assert page.evaluate("document.documentElement.scrollWidth") == PAPER["width"]


def test_paper_shows_both_axes_and_three_moments_of_each_training(visit):
    page = visit("maze")
    page.emulate_media(media="print")
    assert visible(page, ".curves") == [True, True]
    assert visible(page, ".still") == [True] * 3
    assert visible(page, ".still .moments svg") == [True] * 9
    assert visible(page, ".live, nav, .switch") == [False] * 3
    assert visible(page, "button, input, select") == [False] * 7


def test_without_scripts_all_is_there(visit):
    page = visit("maze", java_script_enabled=False)
    assert page.locator(".live").is_hidden()
    assert page.locator(".still").count() == 3
    for i in range(3):
        still = page.locator(".still").nth(i)
        assert still.is_visible()
        assert still.locator(".moments svg").count() == 3
        assert still.locator(".episode").count() == 2
    page.get_by_label("No: weak transfer").check()
    assert page.locator(".curves.weak").is_visible()
    assert page.locator(".curves.strong").is_hidden()


def test_names_do_no_harm(visit):
    page = visit("chain")
    assert page.text_content("h1") == ODD
    assert page.title() == ODD.strip()
    assert page.locator("img").count() == 0
