"""Every page on a phone and on a desk: nothing is wider than the page, and no text is cut."""

import pytest

WIDTHS = [{"width": 360, "height": 740}, {"width": 1300, "height": 900}]
PAGES = ["hunt", "maze", "chain", "many", "runs", "paper"]

# What lies in a box that scrolls, or in a picture, may reach further than the page.
WIDER = """() => [...document.querySelectorAll("body *")].filter(e => {
    if (e.closest(".unseen, .skip") || e.parentElement.closest(".across, svg")) return false;
    const box = e.getBoundingClientRect();
    return box.width > 0 && (box.right > innerWidth + 1 || box.left < -1);
}).map(e => e.outerHTML.slice(0, 120))"""

CUT = """() => [...document.querySelectorAll("body *")].filter(e => {
    if (!e.getClientRects().length || e.closest(".unseen, .skip")) return false;
    if (e instanceof SVGTextElement) {
        const own = e.getBoundingClientRect(), around = e.ownerSVGElement.getBoundingClientRect();
        return own.width > 0 && (own.left < around.left - 1 || own.right > around.right + 1
            || own.top < around.top - 3 || own.bottom > around.bottom + 3);
    }
    if (!(e instanceof HTMLElement) || !e.textContent.trim()) return false;
    const style = getComputedStyle(e), card = e.matches(".card");
    const hides = (way) => card || ["hidden", "clip"].includes(way);
    return hides(style.overflowX) && e.scrollWidth > e.clientWidth + 1
        || hides(style.overflowY) && e.scrollHeight > e.clientHeight + 1;
}).map(e => e.outerHTML.slice(0, 200))"""


@pytest.mark.usefixtures("paper_file")
@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda size: size["width"])
@pytest.mark.parametrize("name", PAGES)
def test_nothing_is_wider_than_the_page_and_no_text_is_cut(visit, name, viewport):
    page = visit(name, viewport)
    for details in page.locator("details").all():
        details.evaluate("e => { e.open = true; }")
    assert page.evaluate("document.documentElement.scrollWidth") == viewport["width"]
    assert page.evaluate(WIDER) == []
    assert page.evaluate(CUT) == []
    used = page.evaluate("document.querySelector('main').getBoundingClientRect().width")
    assert used > 0.85 * viewport["width"]


@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda size: size["width"])
def test_what_scrolls_sideways_says_so(visit, viewport):
    page = visit("maze", viewport)
    found = page.eval_on_selector_all(
        ".across",
        """all => all.filter(e => e.checkVisibility()).map(e => [
            e.scrollWidth > e.clientWidth,
            getComputedStyle(e, "::before").content.includes("scroll"),
        ])""",
    )
    scrolls, said = zip(*found, strict=True)
    assert said == scrolls
    assert any(scrolls) == (viewport["width"] < 1000)


@pytest.mark.usefixtures("paper_file")
@pytest.mark.parametrize("viewport", WIDTHS, ids=lambda size: size["width"])
def test_the_paper_jumps_from_contents_and_summary(visit, viewport):
    page = visit("paper", viewport)
    claims = page.locator("article.claim").count()
    assert page.locator("nav li").count() == page.locator("main > section").count() == 3
    rows = page.locator("#summary td a")
    assert rows.count() == claims > 1
    for n in range(claims):
        rows.nth(n).click()
        claim = page.locator("article.claim:target")
        assert claim.is_visible()
        assert rows.nth(n).text_content() in claim.text_content()
        page.go_back()
    verdicts = page.locator("#summary .stamp").all_text_contents()
    assert verdicts == page.locator("article.claim .stamp").all_text_contents()
    assert page.locator("img").evaluate_all("all => all.every(e => e.complete && e.naturalWidth)")
