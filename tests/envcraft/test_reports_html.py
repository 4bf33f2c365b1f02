"""The HTML page: self-contained, safe with any report, and rendered in a real browser."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings

from envcraft.cli.commands.replay import read_report
from envcraft.judging.frame_renderer import png
from envcraft.model.frame import Frame
from envcraft.model.verdict import Finding, Report, SubjectReport, Verdict
from envcraft.reports.html import HtmlReporter
from envcraft.text import one_line
from tests.envcraft.report_samples import MESSAGE, REPORTS, TRACEBACK, hostile, many, rendered, sample
from tests.pages import chromium, window

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

ATTRIBUTES = {"src", "href", "srcset", "action", "data", "poster", "background", "style"}
TAGS = {
    *("html", "head", "meta", "link", "title", "style", "body", "header", "main", "footer", "section", "script"),
    *("nav", "h2"),
    *("h1", "h3", "p", "a", "b", "code", "pre", "span", "ul", "li", "dl", "div", "dt", "dd", "details", "summary"),
    *("form", "input", "fieldset", "label", "output", "button", "figure", "img", "figcaption", "svg", "rect"),
}
_EMPTY = {"meta", "link", "input", "img", "rect"}


class Parsed(HTMLParser):
    """What a parser makes of the page; everything opened is closed."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.loads: list[tuple[str, str]] = []
        self.names: set[str] = set()
        self.open: list[str] = []
        self.text = ""
        self.feed(page)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.loads += [(name, value or "") for name, value in attrs if name in ATTRIBUTES]
        self.names.update(name for name, _ in attrs)
        if tag not in _EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in _EMPTY:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.text += data


def parsed(report: Report) -> Parsed:
    """The page as parsed, through a stream that takes nothing but ASCII: only our elements, and nothing to load."""
    found = Parsed(rendered(HtmlReporter, report, encoding="ascii", frames=film))
    assert set(found.tags) <= TAGS, set(found.tags) - TAGS
    assert not [name for name in found.names if name.startswith("on")]
    assert not [value for _, value in found.loads if not value.startswith(("data:", "#finding-"))]
    films = found.tags.count("figure")
    assert found.tags.count("script") == 2 + films
    return found


def film(report: SubjectReport, finding: Finding) -> list[Frame]:
    """A dot that moves to the right, for findings that have steps."""
    frames = []
    for step in range(min(len(finding.repro.actions), 12)):
        picture = np.full((12, 12, 3), 40, np.uint8)
        picture[6, step] = 250
        frames.append(Frame(step + 1, png(picture)))
    return frames


def test_the_page_says_everything() -> None:
    found = parsed(sample())
    for words in (
        "1 passed, 1 failed, 0 undecided, 1 could not be judged: 3 findings, 2 warnings",
        "games/bad game.py:41",
        "EC203",
        "hash-seed",
        MESSAGE,
        "Sort sets before iterating over them.",
        "The order of a set shows.",
        TRACEBACK.rstrip(),
        "seed 3, 12 actions, hash_seed 1, fresh worker",
        '{"seed": 3, "actions": [[0, 1, 0]',
        "envcraft replay report.json --finding 4",
        "the budget settled nothing",
        "the worker stopped answering",
        "container by docker",
        "not in force",
        "Landlock",
    ):
        assert words in found.text, words
    assert found.tags.count("figure") == 3


def test_hostile_words_stay_words() -> None:
    found = parsed(hostile())
    for judged in hostile().reports:
        assert one_line(judged.env_class) in found.text


@settings(deadline=None, max_examples=60)
@given(REPORTS)
def test_any_report_is_one_page(report: Report) -> None:
    assert parsed(report).tags.count("section") == sum(
        len(check.findings) for judged in report.reports for check in judged.checks
    )


# In a real browser

Open = Callable[..., "Page"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def show(browser: Browser, tmp_path: Path) -> Iterator[Open]:
    """Open a report's page; nothing may be logged, raised or asked for."""
    complaints: list[str] = []
    contexts = []

    def show(report: Report, fragment: str = "", **options: Any) -> Page:
        path = tmp_path / "report.html"
        path.write_text(rendered(HtmlReporter, report, frames=film), "utf-8")
        context = window(browser, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda request: complaints.append(request.url) if _asks(request.url) else None)
        page.goto(path.as_uri() + fragment)
        return page

    yield show
    for context in contexts:
        context.close()
    assert not complaints, complaints


def _asks(url: str) -> bool:
    return not url.startswith(("data:", "blob:")) and not url.split("#")[0].endswith("/report.html")


@pytest.mark.parametrize("width", [320, 375, 1200])
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("report", [sample, hostile], ids=["sample", "hostile"])
@pytest.mark.browser
def test_it_fits_any_screen(show: Open, report: Callable[[], Report], scheme: str, width: int) -> None:
    page = show(report(), viewport={"width": width, "height": 800}, color_scheme=scheme)
    page.evaluate("document.querySelectorAll('details').forEach((element) => { element.open = true })")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.title().startswith("EnvCraft: ")
    colours = page.evaluate("[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]")
    paper, ink = (sum(int(part) for part in colour[4:-1].split(",")) for colour in colours)
    assert (paper > ink) == (scheme == "light")
    assert abs(paper - ink) > 3 * 150


@pytest.mark.browser
def test_the_film_plays(show: Open) -> None:
    page = show(sample())
    figure = page.locator(".film").first
    button, image, output = (figure.locator(tag) for tag in ("button", "img", "output"))
    moment = image.get_attribute("src")
    assert output.inner_text() == "step 12"
    assert image.evaluate("image => image.naturalWidth") == 12
    button.click()
    seen = _watch(page, image, output)
    assert seen[0][0] in ("step 1", "step 2")
    assert seen[-1] == ("step 12", moment)
    assert len({source for _, source in seen}) >= 6
    assert button.inner_text() == "Play"
    figure.locator("input").focus()
    page.keyboard.press("ArrowLeft")
    assert output.inner_text() == "step 11"
    assert image.get_attribute("src") != moment
    button.press("Enter")
    assert _watch(page, image, output)[-1] == ("step 12", moment)


def _watch(page: Page, image: Locator, output: Locator) -> list[tuple[str, str | None]]:
    seen = []
    for _ in range(200):
        seen.append((output.inner_text(), image.get_attribute("src")))
        if seen[-1][0] == "step 12":
            break
        page.wait_for_timeout(20)
    return seen


@pytest.mark.browser
def test_the_filter_finds_one_of_hundreds(show: Open) -> None:
    page = show(many(400))
    count = page.locator("#shown")
    assert page.locator(".subject:visible").count() == 400
    page.keyboard.press("/")
    page.keyboard.type("game_02 ec203")
    failing = sum(bool(number % 3) for number in range(200, 300))
    assert count.inner_text() == f"{failing} of 400 shown"
    assert page.locator(".subject:visible").count() == failing
    page.get_by_label("passed").check()
    assert page.locator(".subject:visible").count() == 0
    page.locator("#query").fill("GAME_0201")
    assert count.inner_text() == "1 of 400 shown"
    page.get_by_label("all").check()
    page.locator("#query").fill("")
    assert page.locator(".subject:visible").count() == 400
    assert count.inner_text() == ""


@pytest.mark.browser
def test_it_opens_by_keyboard_and_by_link(show: Open) -> None:
    page = show(many(9))
    first = page.locator(".subject").first
    assert not first.evaluate("subject => subject.open")
    first.locator("summary").first.focus()
    page.keyboard.press("Enter")
    assert first.evaluate("subject => subject.open")
    page = show(many(9), "#finding-5")
    assert page.locator("#finding-5").is_visible()
    assert not page.locator("#finding-1").is_visible()


@pytest.mark.browser
def test_the_saved_report_can_be_replayed(show: Open, tmp_path: Path) -> None:
    report = sample()
    page = show(report)
    with page.expect_download() as download:
        page.locator("#save").click()
    saved = tmp_path / download.value.suggested_filename
    download.value.save_as(saved)
    assert saved.name == "report.json"
    assert json.loads(saved.read_text()) == json.loads(report.to_json())
    assert len(read_report(str(saved)).reports) == len(report.reports)


@pytest.mark.browser
def test_nothing_but_the_pages_own_script_may_run(browser: Browser, tmp_path: Path) -> None:
    text = rendered(HtmlReporter, sample())
    path = tmp_path / "forged.html"
    path.write_text(text.replace("</main>", "<script>document.title='owned'</script><img src=x onerror='a()'></main>"))
    page = window(browser).new_page()
    refused: list[str] = []
    page.on("console", lambda message: refused.append(message.text))
    page.goto(path.as_uri())
    assert page.title().startswith("EnvCraft")
    assert len([words for words in refused if "Content Security Policy" in words]) >= 2
    page.close()


@pytest.mark.browser
def test_without_scripts_it_still_reads(show: Open) -> None:
    page = show(sample(), java_script_enabled=False)
    page.locator(".subject summary").first.click()
    page.locator(".subject summary").first.click()
    assert page.get_by_text(MESSAGE).first.is_visible()
    assert page.locator(".film img").first.is_visible()
    assert not page.locator("button:visible").count()


def test_a_report_of_nothing_is_a_page() -> None:
    assert "nothing judged" in parsed(Report("arcade", 0, [])).text
    assert Verdict.PASS in rendered(HtmlReporter, Report("arcade", 0, [sample().reports[0]]))
