"""Markdown: the rendered comment. Hostile text neither breaks it nor becomes links or mentions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser

import pytest
from hypothesis import given, settings
from markdown_it import MarkdownIt

from envcraft.model.verdict import CheckReport, Finding, Report, Severity, Verdict
from envcraft.reports.markdown import LIMIT, MarkdownReporter
from envcraft.text import one_line
from tests.envcraft.report_samples import HOSTILE, MESSAGE, REPORTS, TRACEBACK, hostile, many, rendered, sample, subject

OURS = {"details", "summary", "b", "br", "code", "sub"}
MADE = {"h3", "table", "thead", "tbody", "tr", "th", "td", "p", "pre", "strong"}
#: What GitHub makes something of, outside of code.
LIVE = re.compile(r"@\w|#\d|\bGH-\d|://|\bwww\.\w", re.IGNORECASE)


class Page(HTMLParser):
    """What the renderer made of a comment: its elements, and its text within code and outside."""

    def __init__(self, markdown: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: set[str] = set()
        self.open: list[str] = []
        self.prose = ""
        self.text = ""
        renderer = MarkdownIt("gfm-like", {"html": True, "linkify": True})
        assert renderer.linkify
        # Unlike GitHub it takes any words with a dot for a link.
        renderer.linkify.set({"fuzzy_link": False})
        self.feed(renderer.render(markdown))
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes.update(f"{name}={value}" for name, value in attrs)
        if tag != "br":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        self.prose += data if not {"code", "pre"} & set(self.open) else "\n"

    @property
    def words(self) -> str:
        return self.text.replace("\u200b", "")


def page(report: Report) -> Page:
    comment = rendered(MarkdownReporter, report)
    assert len(comment) <= LIMIT
    found = Page(comment)
    assert set(found.tags) <= OURS | MADE, set(found.tags) - OURS - MADE
    assert found.attributes <= {"class=language-sh", "style=text-align:right"}
    assert found.tags.count("table") == found.tags.count("h3") == found.tags.count("sub") == 1
    assert not LIVE.findall(found.prose), LIVE.findall(found.prose)
    return found


def test_a_sentence_a_table_and_folded_findings() -> None:
    found = page(sample())
    assert found.tags.count("details") == 6
    assert found.tags.count("tr") == 4
    for words in (
        "1 passed, 1 failed, 0 undecided, 1 could not be judged: 3 findings, 2 warnings",
        "EC107 (2), EC203, EC209",
        "games/bad game.py:41",
        MESSAGE,
        "Sort sets before iterating over them.",
        TRACEBACK.rstrip(),
        "seed 3, 12 actions, hash_seed 1, fresh worker",
        "envcraft validate 'games/bad game.py' --seed 3",
        "the worker stopped answering",
        "Use self.np_random.",
    ):
        assert words in found.words, words


def test_errors_come_before_warnings() -> None:
    comment = rendered(MarkdownReporter, sample())
    assert comment.index("games/bad game.py") < comment.index("good.py")
    assert comment.rindex("EC203</b>") < comment.index("EC209</b>")


def test_a_report_without_findings_folds_nothing() -> None:
    good = sample().reports[0]
    good.checks = good.checks[:1]
    comment = rendered(MarkdownReporter, Report("arcade", 0, [good]))
    assert comment.startswith("### ✅ EnvCraft: 1 passed")
    assert "<details>" not in comment


@pytest.mark.parametrize("words", HOSTILE)
def test_hostile_words_stay_words(words: str) -> None:
    whole = hostile()
    for judged in whole.reports:
        if judged.env_class == words:
            found = page(Report("arcade", 0, [judged]))
            assert found.tags.count("details") == 3
            assert one_line(words)[:900] in found.words


@pytest.mark.parametrize("number", [0, 40, 300, 3000])
def test_a_comment_is_never_longer_than_github_takes(number: int) -> None:
    found = page(many(number))
    bad = sum(judged.verdict is Verdict.FAIL for judged in many(number).reports)
    assert found.tags.count("details") + left_out(found) == 2 * bad
    rows = found.tags.count("tr") - 1
    more = re.search(r"and ([\d,]+) more", found.words)
    assert rows + (int(more[1].replace(",", "")) - 1 if more else 0) == number


def left_out(found: Page) -> int:
    left = re.search(r"([\d,]+) more findings and errors are left out", found.words)
    return int(left[1].replace(",", "")) if left else 0


def test_huge_fields_are_cut() -> None:
    finding = Finding("EC107", Severity.ERROR, "x" * 100_000, 1, {"traceback": "`" * 100_000})
    checks = [CheckReport("api", Verdict.FAIL, 0.0, [finding] * 5)]
    found = page(Report("arcade", 0, [subject("a" * 100_000, checks)]))
    assert found.tags.count("details") >= 3
    assert found.tags.count("details") + left_out(found) == 5


@settings(deadline=None, max_examples=100)
@given(REPORTS)
def test_any_report_renders(report: Report) -> None:
    found = page(report)
    assert found.tags.count("details") == len(list(_entries(report)))


def _entries(report: Report) -> Iterator[object]:
    for judged in report.reports:
        broken: list[object] = [check for check in judged.checks if check.verdict is Verdict.ERROR]
        yield from (finding for check in judged.checks for finding in check.findings)
        yield from broken or ([judged] if judged.verdict is Verdict.ERROR else [])
