"""The report as one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
import json
from collections import Counter
from html import escape
from pathlib import Path
from typing import Any

from envcraft.model.events import Event, Finished
from envcraft.model.frame import Frame
from envcraft.model.verdict import CheckReport, Outcome, Report, Severity, SubjectReport, Verdict, plain
from envcraft.plugins import hookimpl
from envcraft.reports.evidence import place_of, raising_place
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import Numbered, numbered, reason_words, repro_words, summary_words
from envcraft.text import one_line, plural, printable

#: Worst first.
_WORDS = {
    Outcome.FAIL: "failed",
    Outcome.ERROR: "not judged",
    Outcome.UNDECIDED: "undecided",
    Outcome.SKIP: "skipped",
    Outcome.PASS: "passed",
}
#: With more environments than this, all are folded.
_UNFOLDED = 3
#: The most failures at the top of the page; the others are with their environments.
_FAILURES = 40


class HtmlReporter(Reporter):
    """Write a summary, the environments with a filter, and each finding with its frames as an animation.

    Every string in a report may come from hostile code, so all are escaped. The page's content security policy runs
    only the page's own script and loads only the pictures in it.
    """

    name = "html"
    summary = "one self-contained page, with the findings as animations"
    suffix = ".html"
    wants_frames = True

    def handle(self, event: Event) -> None:
        if isinstance(event, Finished):
            page = self._page(event.report)
            # Character references can be written to a stream of any encoding.
            self.output.write(page.encode("ascii", "xmlcharrefreplace").decode())

    def _page(self, report: Report) -> str:
        palette, rest, script = (
            Path(__file__).with_name(name).read_text("utf-8") for name in ("palette.css", "page.css", "page.js")
        )
        style = palette + rest
        policy = (
            f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
            "base-uri 'none'; form-action 'none'"
        )
        counts = Counter(subject.outcome for subject in report.reports)
        items = numbered(report)
        self._moments: dict[int, Frame] = {}
        subjects = [
            self._subject(report, subject, [next(items) for check in subject.checks for _ in check.findings])
            for subject in report.reports
        ]
        order = list(_WORDS)
        ranked = sorted(zip(report.reports, subjects, strict=True), key=lambda pair: order.index(pair[0].outcome))
        return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="referrer" content="no-referrer">
<link rel="icon" href="data:,">
<title>EnvCraft: {_text(summary_words(report))}</title>
<style>{style}</style>
</head>
<body>
<header>
<h1>EnvCraft report</h1>
<p class="lede">{_text(summary_words(report))}</p>
{_bar(counts)}
<dl class="facts">{_facts(contract=report.contract, budget=report.budget, seed=report.seed, EnvCraft=report.envcraft)}\
</dl>
</header>
{self._failures(report)}{_filter(counts)}
<main>
{"".join(page for _, page in ranked)}</main>
<footer class="soft">
<p><button type="button" id="save" hidden>Save report.json</button>
<code>envcraft replay report.json</code> runs the reproductions in it again.</p>
</footer>
<script type="application/json" id="report">{_data(report)}</script>
<script>{script}</script>
</body>
</html>
"""

    def _failures(self, report: Report) -> str:
        """The findings that are errors, each with its moment: what a reader of the page looks for first."""
        errors = [item for item in numbered(report) if item.finding.severity is Severity.ERROR]
        entries = []
        for item in errors[:_FAILURES]:
            place = place_of(item.subject, item.finding)
            frame = self._moments.get(item.number)
            moment = _pictures(frame, bool(frame.expected), f"The moment of finding {item.number}") if frame else ""
            moment = f'<div class="moment">{moment}</div>' if moment else ""
            entries.append(
                f'<li>{moment}<div><a href="#finding-{item.number}">'
                f'<span class="fail">{_text(item.finding.code)}</span> <code>{_text(place)}</code></a>'
                f"<p>{_text(item.finding.message)}</p></div></li>\n"
            )
        if not entries:
            return ""
        left = len(errors) - len(entries)
        more = f'<p class="soft">and {left:,} more below</p>' if left else ""
        listed = f"<ul>\n{''.join(entries)}</ul>{more}"
        return f'<nav class="failures" aria-label="Failures"><h2>Failures</h2>\n{listed}</nav>\n'

    def _subject(self, report: Report, subject: SubjectReport, items: list[Numbered]) -> str:
        outcome = subject.outcome
        codes = Counter(item.finding.code for item in items)
        listed = ", ".join(code if count == 1 else f"{code} ({count})" for code, count in codes.items())
        words = " ".join([subject.path, subject.env_class or "", *codes, *(item.finding.message for item in items)])
        opened = " open" if len(report.reports) <= _UNFOLDED and outcome is not Outcome.PASS else ""
        sandbox = subject.isolation
        if subject.driver not in ("", sandbox):
            sandbox += f" by {subject.driver}"
        missing = "; ".join(subject.sandbox.missing)
        reason = subject.reason if outcome is Outcome.ERROR and not any(map(_broken, subject.checks)) else ""
        facts = _facts(
            **{"class": subject.env_class or "none"},
            steps=f"{subject.steps:,}",
            time=f"{subject.seconds:.1f} s",
            isolation=sandbox,
            **({"not in force": missing} if missing else {}),
            **({"policy": subject.policy} if subject.policy else {}),
        )
        return f"""<details class="subject" data-verdict="{outcome}" data-words="{_text(words.lower())}"{opened}>
<summary><span class="verdict {outcome}">{_WORDS[outcome]}</span> <span class="path">{_text(subject.path)}</span> \
<span class="soft">{_text(listed)}</span></summary>
<div class="body">
<dl class="facts">{facts}</dl>
{f'<p class="error">{_text(reason)}</p>' if reason else ""}
<ul class="checks">{"".join(_check(check) for check in subject.checks)}</ul>
{"".join(self._finding(item) for item in items)}</div>
</details>
"""

    def _finding(self, item: Numbered) -> str:
        finding, rule = item.finding, self.rules.get(item.finding.code)
        warning = finding.severity is Severity.WARNING
        located = finding.line or raising_place(item.subject, finding)
        place = place_of(item.subject, finding) if located else ""
        frames = self.frames(item.subject, finding) if self.frames else []
        if frames:
            self._moments[item.number] = frames[-1]
        about = (
            f"<p><b>Fix.</b> {_prose(rule.fix)}</p>\n<details><summary>The rule</summary><p>{_prose(rule.summary)}</p>"
            f'<p class="soft">More: <code>envcraft explain {_text(rule.code)}</code></p></details>\n'
            if rule
            else ""
        )
        evidence = "".join(
            f"<p><b>{_text(key)}</b></p><pre>{_lines(_value(value))}</pre>"
            for key, value in finding.evidence.items()
            if value is not None
        )
        return f"""<section class="finding" id="finding-{item.number}">
<h3><span class="{"warning" if warning else "fail"}">{_text(finding.code)}</span> {_text(rule.name if rule else "")}\
{" (warning)" if warning else ""} <span class="soft">{_text(item.check.check)}</span>\
<a href="#finding-{item.number}" aria-label="Finding {item.number}">#{item.number}</a></h3>
<p class="message">{_text(finding.message)}</p>
{f'<p class="soft"><code>{_text(place)}</code></p>' if place else ""}
{_film(frames, item)}{about}{f"<details><summary>Evidence</summary>{evidence}</details>" if evidence else ""}
<details><summary>Reproduction: {_text(repro_words(finding.repro))}</summary>
<pre>{_lines(json.dumps(plain(finding.repro)))}</pre>
<p>To see it again, with the report saved below:</p>
<pre class="command">envcraft replay report.json --finding {item.number}</pre></details>
</section>
"""


def _film(frames: list[Frame], item: Numbered) -> str:
    """The frames as a film with its controls; without scripts the last one, which is the moment itself."""
    if not frames:
        return ""
    pairs = any(frame.expected for frame in frames)
    reels = [[frame.step, _base64(frame.png), *([_base64(frame.expected)] if pairs else [])] for frame in frames]
    step = frames[-1].step
    alternative = f"The last of {plural(len(frames), 'frame')} that lead to finding {item.number}"
    return f"""<figure class="film{" pair" if pairs else ""}">
{_pictures(frames[-1], pairs, alternative)}
<figcaption hidden><button type="button">Play</button>
<input type="range" min="0" max="{len(frames) - 1}" value="{len(frames) - 1}" aria-label="Frame">
<output>step {step}</output></figcaption>
<script type="application/json">{_data(reels)}</script>
</figure>
"""


def _pictures(frame: Frame, pairs: bool, alternative: str) -> str:
    """The frame of a finding, and with `pairs` the expected one beside it, which is the same where none is given."""
    found = f'<img src="data:image/png;base64,{_base64(frame.png)}" alt="{alternative}">'
    if not pairs:
        return found
    expected = _base64(frame.expected or frame.png)
    words = f"What the same actions show without the conditions of the finding at step {frame.step}"
    return (
        f'<div><span class="soft">found</span>{found}</div>'
        f'<div><span class="soft">expected</span><img src="data:image/png;base64,{expected}" alt="{words}"></div>'
    )


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _bar(counts: Counter[Outcome]) -> str:
    """The verdicts' shares; the sentence above says the same."""
    parts, at = [], 0
    for outcome in reversed(_WORDS):
        parts.append(f'<rect class="{outcome}" x="{at}" width="{counts[outcome]}" height="1"/>')
        at += counts[outcome]
    shape = f'viewBox="0 0 {max(at, 1)} 1" preserveAspectRatio="none" aria-hidden="true"'
    return f'<svg class="bar" {shape}>{"".join(parts)}</svg>'


def _filter(counts: Counter[Outcome]) -> str:
    choices = [("", "all", counts.total())]
    choices += [(outcome.value, word, counts[outcome]) for outcome, word in _WORDS.items() if counts[outcome]]
    radios = "".join(
        f'<label><input type="radio" name="verdict" value="{value}"{"" if value else " checked"}> '
        f"{word} {count:,}</label>"
        for value, word, count in choices
    )
    return f"""<form class="filter" role="search" hidden>
<input type="search" id="query" placeholder="Filter: a file, class, code, words" aria-label="Filter" autocomplete="off">
<fieldset aria-label="Verdict">{radios}</fieldset>
<output id="shown" class="soft" aria-live="polite"></output>
</form>"""


def _check(check: CheckReport) -> str:
    reason = f'<span class="reason">{_text(reason_words(check))}</span>' if check.reason else ""
    return (
        f'<li><span class="verdict {check.outcome}">{check.outcome}</span> <span>{_text(check.check)}</span> '
        f'<span class="time">{check.seconds:.2f} s</span> {reason}</li>'
    )


def _broken(check: CheckReport) -> bool:
    return check.verdict is Verdict.ERROR


def _facts(**facts: Any) -> str:
    return "".join(f"<div><dt>{_text(name)}</dt><dd>{_text(value)}</dd></div>" for name, value in facts.items())


def _text(words: Any) -> str:
    """Escape any text as one line, for an element or a quoted attribute."""
    return escape(one_line(words))


def _lines(words: str) -> str:
    return escape(printable(words))


def _prose(words: str) -> str:
    """Escape the text of a rule, in which backticks mark code."""
    parts = enumerate(_text(words).split("`"))
    return "".join(f"<code>{part}</code>" if index % 2 else part for index, part in parts)


def _value(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(plain(value))


def _data(value: Any) -> str:
    """Encode JSON so that no HTML parser sees the end of a script in it."""
    return json.dumps(plain(value)).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _digest(source: str) -> str:
    """Return the digest by which the content security policy admits a script or a style."""
    return f"sha256-{base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()}"


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [HtmlReporter]
