"""The pages of a report in a real browser: no errors, and no more data is loaded than is shown."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import pytest

from envcraft.text import one_line
from tests.pages import chromium, window

from .reported import HOSTILE, SIZE, source

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.browser
Open = Callable[..., "Page"]


#: A page is ready when its list or its environment is drawn, with the pictures in sight.
READY = """() => {
    const list = document.querySelector("#rows"), sight = (one) => one.getBoundingClientRect().top < innerHeight;
    const drawn = !list || list.getAttribute("aria-busy") === "false" || document.querySelector("#one h1");
    const pictured = [...document.images].every((one) => one.complete || !sight(one));
    return drawn && pictured && document.readyState === "complete";
}"""


@pytest.fixture(scope="module")
def site(reported: tuple[Path, Path]) -> Path:
    return reported[1]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def show(browser: Browser, site: Path) -> Iterator[Open]:
    """Open a page, which may not log, raise or request anything external. ``page.loaded`` has the loaded files."""
    complaints: list[str] = []
    contexts = []

    def show(name: str, **options: Any) -> Page:
        context = window(browser, **options)
        contexts.append(context)
        page = context.new_page()
        urls: list[str] = []
        page.loaded = urls  # type: ignore[attr-defined]
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: urls.append(request.url.removeprefix(site.as_uri() + "/")))
        page.goto(f"{site.as_uri()}/{name}")
        # Not "networkidle": on a busy machine, Chromium may not report the end of each request.
        if options.get("java_script_enabled", True):
            page.wait_for_function(READY)
        return page

    yield show
    for context in contexts:
        context.close()
    assert not complaints, complaints


def loaded(page: Any, kind: str) -> list[str]:
    """The loaded files with this suffix; all are from the folder of the report."""
    urls: list[str] = page.loaded
    assert not [url for url in urls if ":" in url and not url.startswith("data:,")], urls
    return [url for url in urls if url.endswith(kind)]


def scripts(page: Page) -> list[str]:
    """The loaded scripts with data."""
    return [url for url in loaded(page, ".js") if url.startswith("data/")]


@pytest.mark.parametrize("width", [320, 1200])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_any_screen(show: Open, scheme: str, width: int) -> None:
    for name in ("index.html", "environments.html", f"environments.html#environment={quote(one_line(HOSTILE))}"):
        page = show(name, viewport={"width": width, "height": 800}, color_scheme=scheme)
        assert page.evaluate("document.documentElement.scrollWidth") <= width, name
        look = page.evaluate("[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]")
        paper, ink = (sum(int(part) for part in colour[4:-1].split(",")) for colour in look)
        assert (paper > ink) == (scheme == "light")
        assert abs(paper - ink) > 3 * 150


def test_what_is_printed_is_dark_on_paper(show: Open) -> None:
    for name in ("index.html", f"environments.html#environment={quote(one_line(HOSTILE))}"):
        page = show(name, color_scheme="dark")
        page.emulate_media(media="print")
        ink = page.evaluate("getComputedStyle(document.body).color")
        assert sum(int(part) for part in ink[4:-1].split(",")) < 3 * 60, name


def test_figures_take_the_colours_of_the_page(show: Open) -> None:
    colours = set()
    for scheme in ("light", "dark"):
        page = show("index.html", color_scheme=scheme)
        charts = page.locator("svg.chart:visible")
        assert charts.count() == 5
        colours.add(charts.first.locator(".f-pass path, path.f-pass").first.evaluate("e => getComputedStyle(e).fill"))
        assert "difficulty" in (charts.first.text_content() or "")
        narrow = show("index.html", color_scheme=scheme, viewport={"width": 375, "height": 800})
        assert narrow.locator("svg.chart:visible").count() == 5
    assert len(colours) == 2


def test_the_first_page_loads_no_list(show: Open) -> None:
    page = show("index.html")
    assert scripts(page) == []
    assert len(loaded(page, ".webp")) == 2
    page.get_by_role("link", name=f"All {SIZE} environments").click()
    page.wait_for_selector("#rows li")
    assert scripts(page) == ["data/rows-0.js"]


def test_only_what_is_shown_is_loaded(show: Open) -> None:
    page = show("environments.html", viewport={"width": 1200, "height": 800})
    assert 12 <= page.locator("#rows li").count() < 60
    assert scripts(page) == ["data/rows-0.js"]
    # The page is as long as the whole list, and the end is drawn when it comes into sight.
    page.evaluate("() => scrollTo(0, document.documentElement.scrollHeight)")
    page.get_by_text(f"env{SIZE - 1:04}").wait_for()
    assert page.locator("#rows li").count() < 60
    assert scripts(page) == ["data/rows-0.js", "data/rows-1.js"]
    page.evaluate("() => scrollTo(0, 0)")
    page.get_by_text("env0001").click()
    page.wait_for_selector("#one .source")
    assert len(scripts(page)) == 3
    assert page.locator("#one h1").inner_text() == "games/env0001.py"
    page.go_back()
    page.wait_for_selector("#rows li:visible")
    page.locator("#query").fill("env0619")
    page.get_by_text(f"1 of {SIZE}").wait_for()


def test_the_source_and_facets_are_searched(show: Open) -> None:
    page = show("environments.html")
    # The word is in the sources of three copies.
    word = re.findall(r"v([0-9a-f]{8}) = ", source(100).decode())[0]
    page.locator("#query").fill(f"v{word}")
    page.get_by_text(re.compile(rf"^\d+ of {SIZE}$")).wait_for()
    expected = sum(f"v{word}" in source(number).decode() for number in range(SIZE))
    assert page.locator("#shown").inner_text() == f"{expected} of {SIZE}"
    assert len([name for name in scripts(page) if "words" in name]) == 1
    page.locator("#query").fill("")
    page.get_by_label("Speed").select_option("100 to 1,000/s")
    slow = [n for n in range(SIZE) if n != 7 and 100 <= (1000 + n) / (90 if n == 33 else 1 + (n % 17) / 10) < 1000]
    page.get_by_text(f"{len(slow)} of {SIZE}").wait_for()


def test_the_list_filters_and_sorts(show: Open) -> None:
    page = show("environments.html")

    def shown() -> str:
        # Not before the pause after typing is over.
        page.wait_for_timeout(200)
        return page.locator("#shown").inner_text()

    page.keyboard.press("/")
    page.keyboard.type("EC107")
    api = sum(number % 5 == 0 and number not in (7, 11) for number in range(SIZE))
    assert shown() == f"{api} of {SIZE}"
    page.locator("#query").fill("")
    page.locator("#check").select_option("api:skip")
    assert shown() == f"{sum(n % 5 == 3 or n == 11 for n in range(SIZE) if n != 7)} of {SIZE}"
    page.locator("#check").select_option("determinism")
    page.get_by_label("Verdict").select_option("fail")
    both = [n for n in range(SIZE) if n % 7 == 0 and n not in (7, 11)]
    assert shown() == f"{len(both)} of {SIZE}"
    page.locator("#code").select_option("EC107")
    assert shown() == f"{sum(n % 5 == 0 for n in both)} of {SIZE}"
    page.reload()
    page.wait_for_selector("#rows li")
    assert shown() == f"{sum(n % 5 == 0 for n in both)} of {SIZE}"
    for field in ("#check", "#verdict", "#code"):
        page.locator(field).select_option("")
    page.get_by_label("Order").select_option("-seconds")
    shown()
    assert "env0033" in page.locator("#rows li").first.inner_text()
    page.get_by_label("Verdict").select_option("none")
    assert shown() == f"1 of {SIZE}"


def test_an_environment_says_everything_and_runs_nothing(show: Open) -> None:
    page = show(f"environments.html#environment={quote(one_line(HOSTILE))}")
    assert page.title() == one_line(HOSTILE)
    assert page.locator("#one h1").inner_text() == one_line(HOSTILE)
    assert page.locator(".finding").count() == 3
    assert page.locator(".message").first.inner_text() == one_line(HOSTILE)
    page.get_by_text("Evidence").first.click()
    assert HOSTILE.replace("\u202e", "\ufffd") in page.locator(".finding pre").first.inner_text()
    page.get_by_text("Reproduction:").first.click()
    assert "envcraft replay report.json --finding 1" in (page.locator("pre.command").first.text_content() or "")
    page.get_by_role("link", name="line 2").first.click()
    assert page.evaluate("document.activeElement.id") == "line-2"
    assert page.locator(".source li code").nth(1).inner_text() == "import gymnasium"
    # The text of the environment is on the page, and none of it became an element.
    assert page.locator("#one script, #one img:not(.film)").count() == 0


def test_previews_move_while_pointed_at_and_stand_still_for_who_wants_that(show: Open) -> None:
    moving = "document.querySelector('#rows .film').getAnimations().length"
    page = show("environments.html")
    assert page.locator("#rows img.film").count() == 3
    assert page.evaluate(moving) == 0
    page.locator("#rows a").first.hover()
    assert page.evaluate(moving) == 1
    page.mouse.move(0, 0)
    assert page.evaluate(moving) == 0
    page.locator("#rows a").first.focus()
    assert page.evaluate(moving) == 1
    page = show("environments.html", reduced_motion="reduce")
    page.locator("#rows a").first.hover()
    assert page.evaluate(moving) == 0
    page.locator("#rows a").first.click()
    button = page.get_by_role("button", name="Play")
    button.click()
    assert page.evaluate("document.querySelector('#one .film').getAnimations().length") == 1
    assert page.get_by_role("button", name="Pause").is_visible()


def test_it_is_read_by_keyboard(show: Open) -> None:
    page = show("environments.html")
    page.locator("#sort").focus()
    page.keyboard.press("Tab")
    page.keyboard.press("ArrowRight")
    page.wait_for_selector("#rows a[data-place='1']:focus")
    page.keyboard.press("ArrowDown")
    page.wait_for_selector("#rows a:focus:not([data-place='1'])")
    page.keyboard.press("Enter")
    page.wait_for_selector("#one .source")
    assert page.evaluate("() => document.activeElement.tagName") == "H1"
    page.keyboard.press("]")
    page.wait_for_selector("#one .source")
    page.keyboard.press("Escape")
    page.wait_for_selector("#rows li:visible")


def test_a_report_that_lacks_a_file_says_so(browser: Browser, site: Path) -> None:
    page = window(browser).new_page()
    page.goto(f"{site.as_uri()}/environments.html")
    page.evaluate("info.total = 2000")
    page.locator("#query").fill("zzz")
    page.get_by_text("incomplete").wait_for()
    page.close()


def test_without_scripts_it_says_where_the_list_is(show: Open) -> None:
    page = show("environments.html", java_script_enabled=False)
    assert page.locator("noscript .note").is_visible()
    page = show("index.html", java_script_enabled=False)
    assert page.locator("svg.chart:visible").count() == 5
