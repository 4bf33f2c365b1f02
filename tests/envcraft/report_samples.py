"""Reports for the tests of the reporters: an ordinary one, a hostile one, and any that hypothesis thinks of."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable
from typing import Any

from hypothesis import strategies as st

from envcraft.judging.check import Rule
from envcraft.model.events import CheckFinished, CheckStarted, Event, Finished, SubjectFinished, SubjectStarted
from envcraft.model.frame import FrameSource
from envcraft.model.verdict import (
    CheckReport,
    Finding,
    Report,
    Repro,
    SandboxReport,
    Severity,
    SubjectReport,
    Verdict,
    overall,
)
from envcraft.reports.reporter import Reporter

RULES = {
    "EC107": Rule("EC107", "step-raises", "step() raises on a legal action.", "Check bounds before indexing."),
    "EC203": Rule("EC203", "hash-seed", "The order of a `set` shows.", "Sort sets before iterating over them."),
    "EC209": Rule("EC209", "same-seeds", "All seeds give one level.", "Use `self.np_random`.", Severity.WARNING),
}
MESSAGE = "seed 0 gives another trace under another PYTHONHASHSEED: the observation differs at step 12"
TRACEBACK = '  File "bad.py", line 91, in _drill\n    if self.cells[row, column] in (SOIL, STONE):\nIndexError\n'

#: Words that an environment may choose, each written against one format or several.
HOSTILE = (
    "<script>document.title='owned'</script>",
    "</script><script>document.title='owned'</script>",
    "</style><img src=x onerror=\"document.title='owned'\">",
    "'\"><svg onload=document.title='owned'>",
    "javascript:document.title='owned'",
    "]]> <!-- & &amp; &#64; --> <?pi?>",
    "@everyone and @octocat and #1 and GH-1 and octo/repo#2 see https://evil.example www.evil.example me@evil.example",
    "a | b ` c `` d ``` e\n```\n# heading\n- list\n> quote\n***\n[link](https://evil.example) ![image](https://evil.example/x.png)",
    "</details></details></table> **bold** _em_ ~~gone~~ \\| \\",
    "50% 100%0A::error::forged\n::error file=x.py::forged\r\n::set-output name=x::y ::stop-commands::z ##[error]forged",
    "a:b,c=d::e %25 {0} {{1}}",
    "bell\x07 nul\x00 escape\x1b[2J c1\x9b del\x7f \ufffe\uffff \ud800\udc80 \u202egnp \u2028 \u2029 \u061c",
    "",
    "   ",
    "日本語 Ünïcödé 🎮",
    "long " * 2000,
)


def sample() -> Report:
    """One subject of each verdict, with findings, warnings, a skip and an error."""
    repro = Repro(3, [[0, 1, 0]] * 12, {"hash_seed": 1, "fresh": True})
    crash = Finding(
        "EC107", Severity.ERROR, "step 155 raises IndexError", 91, {"traceback": TRACEBACK, "step": 155}, repro
    )
    order = Finding("EC203", Severity.ERROR, MESSAGE, 41, {"step": 12, "reward": float("nan")}, repro)
    same = Finding("EC209", Severity.WARNING, "seeds 0 and 1 give one level")
    passed = CheckReport("source", Verdict.PASS, 0.1)
    skipped = CheckReport("difficulty", Verdict.SKIP, reason="the budget settled nothing")
    bad = [passed, CheckReport("api", Verdict.FAIL, 1.25, [crash, crash])]
    bad += [CheckReport("determinism", Verdict.FAIL, 0.4, [order, same]), skipped]
    lost = [passed, CheckReport("api", Verdict.ERROR, reason="the worker stopped answering")]
    return Report(
        "arcade",
        3,
        [
            subject("good.py", [passed, CheckReport("determinism", Verdict.PASS, 0.2, [same])]),
            subject("games/bad game.py", bad, sandbox=SandboxReport("docker", ["seccomp"], ["Landlock"])),
            subject("lost.py", lost, reason="the worker stopped answering"),
        ],
    )


def hostile() -> Report:
    """Every field that code under test has a say in holds hostile words."""
    subjects = []
    for words in HOSTILE:
        finding = Finding("EC107", Severity.ERROR, words, 1, {words: words}, Repro(0, [words], {"clock": words}))
        checks = [
            CheckReport("source", Verdict.PASS),
            CheckReport("api", Verdict.FAIL, 0.1, [finding, Finding(words, Severity.WARNING, words)]),
            CheckReport(words, Verdict.SKIP, reason=words),
            CheckReport("reward", Verdict.ERROR, reason=words),
        ]
        sandbox = SandboxReport(words, [words], [words], words)
        path = os.fsdecode(words.replace("\0", "")[:200].encode("utf-8", "surrogatepass")) + ".py"
        subjects.append(subject(path, checks, env_class=words, policy=words, reason=words, sandbox=sandbox))
    return Report("arcade", 0, subjects)


def subject(path: str, checks: list[CheckReport], **fields: Any) -> SubjectReport:
    given: dict[str, Any] = {"env_class": "Game", "driver": "docker", **fields}
    return SubjectReport(
        path=path,
        source_sha256="0" * 64,
        verdict=overall(checks),
        isolation="container",
        seconds=2.5,
        steps=20480,
        checks=checks,
        **given,
    )


def many(number: int, findings: int = 2) -> Report:
    """A corpus: every third subject passes."""
    finding = Finding("EC203", Severity.ERROR, MESSAGE, 41, {"traceback": TRACEBACK}, Repro(3, [[0, 1, 0]] * 12))
    checks = [CheckReport("source", Verdict.PASS), CheckReport("determinism", Verdict.FAIL, 0.4, [finding] * findings)]
    return Report("arcade", 0, [subject(f"games/game_{i:04}.py", checks[: 1 + bool(i % 3)]) for i in range(number)])


def events(report: Report) -> Iterable[Event]:
    """The events that ``validate`` would send to a reporter."""
    for number, subject in enumerate(report.reports, 1):
        yield SubjectStarted(subject.path, number, len(report.reports))
        for check in subject.checks:
            yield CheckStarted(subject.path, check.check)
            yield CheckFinished(subject.path, check)
        yield SubjectFinished(subject)
    yield Finished(report)


def rendered(kind: type[Reporter], report: Report, encoding: str = "utf-8", frames: FrameSource | None = None) -> str:
    """What a reporter writes, through a stream that refuses what it cannot encode."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, newline="\n")
    reporter = kind(stream, RULES)
    reporter.frames = frames
    for event in events(report):
        reporter.handle(event)
    stream.flush()
    stream.seek(0)
    return stream.read()


_TEXT = st.one_of(st.text(st.characters(codec=None), max_size=30), st.sampled_from(HOSTILE))
#: As the operating system gives them: any bytes but NUL.
_PATHS = st.binary(min_size=1, max_size=30).map(lambda path: os.fsdecode(path.replace(b"\0", b"?")))
_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | _TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_TEXT, inner, max_size=3),
    max_leaves=5,
)
_FINDINGS = st.builds(
    Finding,
    st.sampled_from([*RULES, "XX001"]) | _TEXT,
    st.sampled_from(Severity),
    _TEXT,
    st.none() | st.integers(0, 10_000),
    st.dictionaries(_TEXT, _VALUES, max_size=2),
    st.builds(
        Repro, st.integers(0, 2**63 - 1), st.lists(_VALUES, max_size=3), st.dictionaries(_TEXT, _VALUES, max_size=2)
    ),
)
_CHECKS = st.builds(
    CheckReport,
    st.sampled_from(["source", "api"]) | _TEXT,
    st.sampled_from(Verdict),
    st.floats(0, 1e6),
    st.lists(_FINDINGS, max_size=3),
    _TEXT,
)
_SUBJECTS = st.builds(
    SubjectReport,
    path=_PATHS,
    env_class=st.none() | _TEXT,
    source_sha256=st.text("0123456789abcdef", min_size=64, max_size=64),
    verdict=st.sampled_from(Verdict),
    isolation=st.sampled_from(["container", "process"]),
    seconds=st.floats(0, 1e6),
    steps=st.integers(0, 10**9),
    checks=st.lists(_CHECKS, max_size=3),
    reason=_TEXT,
    policy=st.none() | _TEXT,
    sandbox=st.builds(SandboxReport, _TEXT, st.lists(_TEXT, max_size=2), st.lists(_TEXT, max_size=2)),
)
REPORTS = st.builds(
    Report,
    st.sampled_from(["arcade", "gymnasium"]) | _TEXT,
    st.integers(0, 2**31 - 1),
    st.lists(_SUBJECTS, max_size=3),
)
