"""The page of a study in a browser: by mouse and keyboard, on a phone, on paper, offline."""

import re

import pytest
from markupsafe import Markup

from curricle.show.report import render

PAPER = {"width": 688, "height": 1000}  # what A4 leaves between its margins
PHONE = {"width": 360, "height": 740}
SHOWN = "e => e.getClientRects().length > 0"


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


def tab_to(page, name):
    """Press the tabulator until this element has the focus."""
    for _ in range(80):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == name:
            return
    raise AssertionError(f"the keyboard never reaches {name}")


def visible(page, selector):
    return [page.evaluate(SHOWN, one) for one in page.query_selector_all(selector)]


@pytest.mark.parametrize("name", ["hunt", "maze", "chain"])
def test_the_script_draws_what_the_page_was_written_with(visit, name):
    page = visit(name)
    keys = page.eval_on_selector_all("#which option", "all => all.map(one => one.value)")
    assert len(keys) == 3
    for key in keys:
        page.select_option("#which", key)
        last = int(page.get_attribute("#moment", "max"))
        for n, place in enumerate(sorted({0, last // 2, last}), start=1):
            page.locator("#moment").fill(str(place))
            still = f'.still[data-key="{key}"] .moments figure:nth-child({n})'
            assert drawn(page, "#map svg") == drawn(page, f"{still} svg")
            step = page.text_content(f"{still} figcaption").removeprefix("step ")
            assert page.text_content("#moment-words").startswith(f"Step {step} of ")


def test_another_replay_has_its_own_grid(visit):
    page = visit("hunt")
    assert page.locator("#map .fixed").count() == 2  # the prey and the other predator
    page.select_option("#which", index=page.locator("#which option").count() - 1)  # chase
    assert page.locator("#map .fixed").count() == 1
    assert page.locator("#before .marker").count() == 2


def places(page):
    markers = "#before .marker, #after .marker"
    return page.eval_on_selector_all(markers, "all => all.map(e => e.style.transform)")


def test_the_animation_plays_pauses_and_ends(visit):
    page = visit("maze")
    start, most = places(page), int(page.get_attribute("#tick", "max"))
    page.click("#episode-play")
    page.clock.run_for(1500)
    moved = int(page.input_value("#tick"))
    assert 0 < moved < most
    assert places(page) != start
    page.get_by_role("button", name="Pause").click()
    held = places(page)
    page.clock.run_for(5000)
    assert (int(page.input_value("#tick")), places(page)) == (moved, held)
    page.click("#episode-play")
    page.clock.run_for(60_000)
    assert int(page.input_value("#tick")) == most
    assert page.text_content("#episode-play") == "Play"
    outcomes = page.locator("#episodes .outcome").all_text_contents()
    key = page.input_value("#which")
    assert outcomes == page.locator(f'.still[data-key="{key}"] .outcome').all_text_contents()


@pytest.mark.parametrize(("motion", "still"), [("no-preference", False), ("reduce", True)])
def test_nothing_glides_where_motion_is_unwelcome(visit, motion, still):
    marker = visit("maze", reduced_motion=motion).locator("#after .marker").first
    assert (marker.evaluate("e => getComputedStyle(e).transitionDuration") == "0s") == still


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


@pytest.mark.parametrize("name", ["hunt", "maze", "chain"])
def test_nothing_is_wider_than_paper(visit, name):
    page = visit(name, PAPER)
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


def test_paper_shows_both_axes_once_and_nothing_to_click(visit):
    page = visit("maze")
    beside, static = page.locator(".answered .plot"), page.locator(".curves.weak .wide")
    shown = [page.locator("#chart"), beside, static]
    assert [part.is_visible() for part in shown] == [True, True, False]
    page.emulate_media(media="print")
    assert [part.is_visible() for part in shown] == [False, True, True]
    assert visible(page, ".curves.strong, #watch, nav, .switch") == [False] * 4
    assert not any(visible(page, "button:not(.legend *), input, select, details"))
    page.locator("#measures details").evaluate("e => { e.open = true; }")
    assert page.locator(".meanings").is_visible()


def test_five_arms_fit_on_four_sheets(visit):
    sheets = visit("five").pdf(format="A4", prefer_css_page_size=True)
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", sheets)) <= 4


def test_the_curve_is_beside_the_verdicts_and_above_them_on_a_phone(visit):
    def corners(page):
        boxes = [page.locator(part).first.bounding_box() for part in (".answered", ".finding")]
        return [(box["x"], box["y"]) for box in boxes]

    (left, top), (right, side) = corners(visit("hunt"))
    assert (top == side, left < right) == (True, True)
    (left, top), (right, side) = corners(visit("hunt", PHONE))
    assert (top < side, left == right) == (True, True)


FAINT = """least => [...document.querySelectorAll(
    "p, li, td, th, h1, h2, h3, h4, a, code, figcaption, button, .plot text"
)].filter(e => e.getClientRects().length && e.textContent.trim() && !e.disabled).map(e => {
    const light = (css) => css.match(/[\\d.]+/g).slice(0, 3).map(x => x / 255)
        .map(x => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4)
        .reduce((sum, x, n) => sum + x * [0.2126, 0.7152, 0.0722][n], 0.05);
    let box = e;
    while (box && /, 0\\)$/.test(getComputedStyle(box).backgroundColor)) box = box.parentElement;
    const ends = [getComputedStyle(box).backgroundColor, e instanceof SVGElement
        ? getComputedStyle(e).fill : getComputedStyle(e).color].map(light).sort((a, b) => a - b);
    return [ends[1] / ends[0], e.outerHTML.slice(0, 90)];
}).filter(([contrast]) => contrast < least)"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_and_lines_stand_out_in_either_scheme(visit, scheme):
    page = visit("hunt", color_scheme=scheme)
    assert page.evaluate(FAINT, 4.5) == []
    strokes = page.eval_on_selector_all(
        ".plot path[style*='stroke-width: 1.5'], .swatch path, .forest path, .edges path",
        "all => all.map(e => getComputedStyle(e).stroke)",
    )
    paper = page.evaluate("getComputedStyle(document.body).backgroundColor")
    lights = [luminance(colour) + 0.05 for colour in strokes]
    ground = luminance(paper) + 0.05
    assert min(max(x, ground) / min(x, ground) for x in lights) >= 2.2  # orange on white; on dark 3
    assert (ground < 0.1) == (scheme == "dark")


def luminance(colour):
    parts = [float(x) / 255 for x in re.findall(r"[\d.]+", colour)[:3]]
    linear = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in parts]
    return sum(x * weight for x, weight in zip(linear, (0.2126, 0.7152, 0.0722), strict=True))


def test_without_scripts_all_is_there(visit):
    page = visit("maze", java_script_enabled=False)
    assert page.locator(".live").is_hidden()
    assert visible(page, ".still, .still .moments svg, .still .episode") == [True] * 17
    assert page.locator("#chart, .tools").filter(visible=True).count() == 0
    assert page.locator("#arms").is_visible()
    page.get_by_label("No: weak transfer").check()
    assert page.locator(".curves.weak").is_visible()
    assert page.locator(".curves.strong").is_hidden()


def test_an_interim_page_is_read_again_but_not_under_its_readers_hands(visit, files):
    files["interim"] = files["maze"].with_name("interim.html")

    def write(words, seconds):
        banner = render("banner.html", {"sentence": words, "time": "12:00:00", "seconds": seconds})
        tall = Markup(banner + '<div style="height: 300rem"></div>')
        files["interim"].write_text(render("waiting.html", {"name": "Interim", "banner": tall}))

    write("not begun", 0)
    page = visit("interim")
    write("1 of 3 units", 2)
    page.reload()
    page.evaluate("scrollTo(0, 700)")
    write("2 of 3 units", 2)
    page.keyboard.press("Shift")
    page.clock.run_for(9_000)
    assert "1 of 3" in page.text_content("#interim")
    with page.expect_navigation():
        page.clock.run_for(4_000)
    assert "2 of 3" in page.text_content("#interim")
    assert page.evaluate("scrollY") == 700
    write("all", 0)
    with page.expect_navigation():
        page.clock.run_for(3_000)
    write("never", 0)
    page.clock.run_for(60_000)
    assert "all" in page.text_content("#interim")
