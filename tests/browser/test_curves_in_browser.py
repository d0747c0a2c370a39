"""The learning curves of a page answer: values, zoom, arms and seeds on and off, files."""

import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from curricle.show.plots import shown_curve
from curricle.statistics.intervals import mean_interval

DESK, PHONE = {"width": 1300, "height": 900}, {"width": 390, "height": 844}
SWITCHES = {"strong": "Yes: strong transfer", "weak": "No: weak transfer"}


def scrolled(page):
    """The rectangle of the curves in the window, in which they are scrolled to."""
    page.locator("#chart").scroll_into_view_if_needed()
    return page.locator("#chart").bounding_box()


def across(page, steps):
    """The horizontal place of a number of steps in the window, from the ticks of the axis."""
    ticks = page.eval_on_selector_all(
        "#chart > text[text-anchor='middle']",
        "all => all.map(e => [e.textContent.replaceAll(',', ''), e.getAttribute('x')])",
    )
    values, places = np.array(ticks, dtype=float).T
    slope, start = np.polyfit(values, places, 1)
    return scrolled(page)["x"] + start + slope * steps


def point_at(page, steps):
    box = scrolled(page)
    page.mouse.move(across(page, steps), box["y"] + box["height"] / 2)


def read(page):
    """What stands beside the curves: steps, and the numbers of each arm."""
    words = page.eval_on_selector_all(
        "#arms li", "all => all.map(e => [e.dataset.arm, e.querySelector('.value').textContent])"
    )
    (steps,) = re.findall(r"([\d,]+) steps", page.text_content("#chart-steps"))
    plain = {arm: re.sub(",(?! )", "", text.replace("\u2212", "-")) for arm, text in words}
    return int(steps.replace(",", "")), {
        arm: [float(x) for x in re.findall(r"-?[\d.]+", t)] for arm, t in plain.items()
    }


def ticks_of(page):
    return page.locator("#chart > text[text-anchor='middle']").all_text_contents()


def means(page):
    return page.eval_on_selector_all(
        "#chart .mean", "all => all.map(e => e.parentNode.dataset.arm)"
    )


@pytest.mark.parametrize("panel", ["strong", "weak"])
@pytest.mark.parametrize("viewport", [DESK, PHONE])
def test_hovered_values_are_those_of_the_data(visit, studies, panel, viewport):
    comparison, page = studies["maze"][0], visit("maze", viewport)
    page.get_by_label(SWITCHES[panel]).check()
    digits = json.loads(page.text_content("#curves-data"))["digits"]
    for share in (0.3, 0.62, 0.97):
        checkpoints = shown_curve(comparison, "scratch", strong=panel == "strong")[0].steps
        wanted = int(checkpoints[int(share * (len(checkpoints) - 1))])
        spacing = int(checkpoints[1])
        point_at(page, wanted + 0.3 * spacing)  # the nearest is meant
        steps, values = read(page)
        assert steps == wanted
        for arm, numbers in values.items():
            curve, _ = shown_curve(comparison, arm, strong=panel == "strong")
            (place,) = np.flatnonzero(curve.steps == wanted)
            band = mean_interval(curve.filled()[:, place]).within(comparison.within)
            expected = [x for x in (band.estimate, band.low, band.high) if not np.isnan(x)]
            assert numbers == pytest.approx(expected, abs=0.51 * 10**-digits)
    page.mouse.move(1, 1)
    assert page.text_content("#chart-steps") == f"At the end, {checkpoints[-1]:,} steps"


def test_an_arm_is_turned_off_and_on_by_its_name_and_seeds_are_thin_lines(visit):
    page, alone = visit("maze"), ["scratch", "scratch, OptimisticQLearning"]
    assert means(page) == [*alone, "maze arm"]
    button = page.get_by_role("button", name="maze arm")
    button.click()
    assert means(page) == alone
    assert page.locator('#chart [data-arm="maze arm"]').count() == 0
    assert button.get_attribute("aria-pressed") == "false"
    assert page.locator('#arms [data-arm="maze arm"] .value').is_hidden()
    button.press("Enter")
    assert means(page) == [*alone, "maze arm"]
    assert page.locator("#chart .band").count() == 3
    page.get_by_label("each seed as a thin line").check()
    assert page.locator("#chart .seed").count() == 3 * 3
    assert page.locator("#chart .band").count() == 0


def test_of_many_arms_only_the_line_under_the_pointer_has_a_band(visit):
    page = visit("many")
    shown = "all => all.filter(e => e.getAttribute('display') !== 'none').map(e => e.dataset.arm)"

    def bands():
        return page.eval_on_selector_all("#chart .band", shown)

    assert len(means(page)) > 6
    assert bands() == []
    point_at(page, 1500)
    (arm,) = bands()
    assert page.locator("#arms .nearest").get_attribute("data-arm") == arm
    page.locator("#arms li").last.hover()
    assert bands() == [page.locator("#arms li").last.get_attribute("data-arm")]
    page.mouse.move(1, 1)
    assert bands() == []
    assert page.locator("#arms .nearest").count() == 0
    for button in page.locator("#arms button").all()[6:]:
        button.click()
    assert len(bands()) == len(means(page)) == 6  # the others have room for their bands


def test_a_drag_zooms_and_a_double_click_resets(visit):
    page = visit("maze")
    before, box = ticks_of(page), scrolled(page)
    middle = box["y"] + box["height"] / 2
    page.mouse.move(across(page, 1000), middle)
    page.mouse.down()
    page.mouse.move(across(page, 2000), middle + 5, steps=4)
    page.mouse.up()
    shown = [int(tick.replace(",", "")) for tick in ticks_of(page)]
    assert 1000 <= min(shown) < max(shown) <= 2000
    assert page.locator("#chart-reset").is_enabled()
    page.mouse.dblclick(box["x"] + box["width"] / 2, middle)
    assert ticks_of(page) == before
    assert page.locator("#chart-reset").is_disabled()
    labels = "#chart > text[text-anchor='end']"
    heights = page.locator(labels).all_text_contents()
    page.mouse.move(box["x"] + 200, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 160, steps=4)  # over a rectangle
    page.mouse.up()
    assert page.locator(labels).all_text_contents() != heights
    page.get_by_role("button", name="Reset").click()
    assert page.locator(labels).all_text_contents() == heights


def test_the_keyboard_reads_values_and_zooms(visit, studies):
    page, comparison = visit("maze"), studies["maze"][0]
    steps = comparison.scratch.curve.steps
    whole = ticks_of(page)
    page.focus("#chart")
    page.keyboard.press("Home")
    assert read(page)[0] == steps[0]
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert read(page)[0] == steps[2]
    words = page.get_attribute("#chart", "aria-valuetext")
    assert words.startswith(f"{steps[2]:,} steps: scratch ")
    page.keyboard.press("End")
    assert read(page)[0] == steps[-1]
    page.keyboard.press("+")
    page.keyboard.press("+")
    near = ticks_of(page)
    assert int(near[0].replace(",", "")) >= steps[-1] // 2
    page.keyboard.press("Home")  # what is shown follows
    assert ticks_of(page)[0] == "0"
    page.keyboard.press("0")
    assert ticks_of(page) == whole
    for name, changed in (("Zoom in", True), ("Zoom out", False)):
        page.get_by_role("button", name=name).click()
        assert (ticks_of(page) != whole) == changed


def test_a_finger_reads_values_and_does_not_zoom(visit):
    page = visit("maze", PHONE, has_touch=True)
    before, box = ticks_of(page), scrolled(page)
    page.touchscreen.tap(across(page, 1500), box["y"] + 100)
    assert read(page)[0] == 1500
    assert ticks_of(page) == before


def test_what_is_shown_can_be_saved(visit, tmp_path):
    page = visit("maze")
    page.get_by_role("button", name="maze arm").click()
    for name, ending in (("Save as SVG", "svg"), ("Save as PNG", "png")):
        with page.expect_download() as waited:
            page.get_by_role("button", name=name).click()
        assert waited.value.suggested_filename == f"learning-curves-strong.{ending}"
        waited.value.save_as(tmp_path / f"saved.{ending}")
    svg = (tmp_path / "saved.svg").read_text("utf-8")
    drawn = ElementTree.fromstring(svg)
    words = [text.text for text in drawn.iter("{http://www.w3.org/2000/svg}text")]
    assert ("scratch" in words, "maze arm" in words) == (True, False)
    assert "http" not in svg.replace("http://www.w3.org/2000/svg", "")
    png = (tmp_path / "saved.png").read_bytes()
    assert png.startswith(b"\x89PNG")
    size = float(drawn.get("width")), float(drawn.get("height"))
    assert [int.from_bytes(png[n : n + 4]) for n in (16, 20)] == [2 * side for side in size]
