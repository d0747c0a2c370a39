"""The learning curves of a page answer: values, zoom, arms and seeds on and off."""

import json
import re

import numpy as np
import pytest

from curricle.show.plots import shown_curve
from curricle.statistics.intervals import mean_interval

DESK, PHONE = {"width": 1300, "height": 900}, {"width": 390, "height": 844}
SWITCHES = {"strong": "Yes: strong transfer", "weak": "No: weak transfer"}


def scrolled(page):
    """The rectangle of the curves in the window, in which they are scrolled to."""
    page.locator("#chart").scroll_into_view_if_needed()
    return page.locator("#chart .u-over").bounding_box()


def across(page, steps):
    """The horizontal place of a number of steps in the window, where all steps are shown."""
    data, box = json.loads(page.text_content("#curves-data")), scrolled(page)
    panel = "strong" if page.locator("#axis-strong").is_checked() else "weak"
    last = data["steps"][len(data["arms"][0][panel]["mean"]) - 1]
    return box["x"] + box["width"] * steps / last


def point_at(page, steps):
    box = scrolled(page)
    page.mouse.move(across(page, steps), box["y"] + box["height"] / 2)


def picture(page):
    return page.eval_on_selector("#chart canvas", "canvas => canvas.toDataURL()")


def shown_steps(page):
    """The first and the last steps that are shown."""
    box, ends = scrolled(page), []
    for x in (box["x"] + 1, box["x"] + box["width"] - 1):
        page.mouse.move(x, box["y"] + box["height"] / 2)
        ends.append(read(page)[0])
    page.mouse.move(1, 1)
    return ends


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


def test_an_arm_is_turned_off_and_on_by_its_name_and_seeds_are_lines(visit):
    page = visit("maze")
    whole, button = picture(page), page.get_by_role("button", name="maze arm", exact=True)
    button.click()
    page.mouse.move(1, 1)
    assert picture(page) != whole
    assert button.get_attribute("aria-pressed") == "false"
    assert page.locator('#arms [data-arm="maze arm"] .value').is_hidden()
    button.press("Enter")
    assert picture(page) == whole
    page.get_by_label("each seed as a thin line").check()
    assert picture(page) != whole
    page.get_by_label("each seed as a thin line").uncheck()
    assert picture(page) == whole


def test_of_many_arms_only_the_line_under_the_pointer_has_a_band(visit):
    page = visit("many")
    without = picture(page)
    point_at(page, 1500)
    assert page.locator("#arms .nearest").count() == 1
    assert picture(page) != without
    page.locator("#arms li").last.hover()
    assert page.locator("#arms .nearest").count() == 1
    assert page.locator("#arms li").last.get_attribute("class") == "nearest"
    page.mouse.move(1, 1)
    assert page.locator("#arms .nearest").count() == 0
    assert picture(page) == without


def test_the_keyboard_reads_values_and_zooms(visit, studies):
    page, comparison = visit("maze"), studies["maze"][0]
    steps = comparison.scratch.curve.steps
    whole = shown_steps(page)
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
    assert shown_steps(page)[0] >= steps[-1] // 2
    page.keyboard.press("Home")  # what is shown follows
    assert read(page)[0] == steps[0]
    assert shown_steps(page)[0] == steps[0]
    page.keyboard.press("0")
    assert shown_steps(page) == whole
    for name, changed in (("Zoom in", True), ("Zoom out", False)):
        page.get_by_role("button", name=name).click()
        assert (shown_steps(page) != whole) == changed


def test_a_finger_reads_values_and_does_not_zoom(visit):
    page = visit("maze", PHONE, has_touch=True)
    box = scrolled(page)
    page.touchscreen.tap(across(page, 1500), box["y"] + 100)
    assert read(page)[0] == 1500
    assert page.locator("#chart-reset").is_disabled()
