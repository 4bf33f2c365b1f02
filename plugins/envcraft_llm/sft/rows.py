"""The rows of a concept, in the forms that TRL documents as conversational [1]_.

What a row asks is what the pipeline asked, and what it answers is one file in one fence, as the prompts want it.

.. [1] https://huggingface.co/docs/trl/dataset_formats
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from envcraft.stages import Attempt, Case
from envcraft.verdict import SubjectReport
from envcraft_llm.findings import findings, to_repair, told
from envcraft_llm.stages import code, repair

from .gate import Judged, sha256

if TYPE_CHECKING:
    import pyarrow

Column = tuple[str, str, str]
Row = dict[str, Any]
#: What there is, with what it is in words and its own columns: name, type, what it has.
KINDS: dict[str, tuple[str, tuple[Column, ...]]] = {
    "code": (
        "a brief, and a validated environment of it",
        (("messages", "list<message>", "system, user (the brief), assistant (the file)"),),
    ),
    "repair": (
        "a broken attempt with what the checks found, in words, and the validated environment that it became",
        (
            ("messages", "list<message>", "system, user (brief, broken file, findings), assistant (the mended file)"),
            ("broken", "string", "the file that is repaired"),
            ("findings", "string", "what the checks found in it, as the request tells it"),
            ("mended", "string", "the file that was validated"),
        ),
    ),
    "preference": (
        "a brief, a validated environment of it, and an earlier attempt that was not good enough",
        (
            ("prompt", "list<message>", "system, user (the brief)"),
            ("chosen", "list<message>", "assistant: the file that was validated"),
            ("rejected", "list<message>", "assistant: the file that was not good enough"),
            ("rejected_attempt", "int64", "the number of that attempt; the other columns are about the chosen one"),
            ("rejected_sha256", "string", "the SHA-256 of its file"),
            ("rejected_codes", "list<string>", "the codes of what the checks found in it"),
            ("rejected_reason", "string", "why it did not pass"),
            ("rejected_model", "string", "the model that wrote it"),
            ("rejected_request_sha256", "string", "the SHA-256 of the request for it"),
        ),
    ),
    "unpaired": (
        "every attempt that was judged to the end, and whether it passed",
        (
            ("prompt", "list<message>", "system, user: the brief, or for a repair what it was told"),
            ("completion", "list<message>", "assistant: the file"),
            ("label", "bool", "whether it became a validated environment"),
            ("reason", "string", "why not, empty where it did"),
        ),
    ),
}
#: What every row has, of the attempt that it teaches or labels. No name is one that trainers look for.
PROVENANCE: tuple[Column, ...] = (
    ("concept", "string", "the id of the concept"),
    ("title", "string", "of the game"),
    ("cluster", "int64", "rows with the same number are of concepts with near-duplicate sources, and in one split"),
    ("environment", "string", "what the validated environment is called in the corpus"),
    ("attempt", "int64", "the number of the attempt: 0 is the first, then repairs"),
    ("code_sha256", "string", "the SHA-256 of its file in UTF-8"),
    ("codes", "list<string>", "the codes of what the checks found in it"),
    ("parent", "int64", "the number of the attempt that it repairs"),
    ("parent_sha256", "string", "the SHA-256 of that one's file"),
    ("parent_codes", "list<string>", "the codes of what the checks found in that one"),
    ("model", "string", "the model that wrote it, by the name that was asked for"),
    ("request_sha256", "string", "the SHA-256 of the request, under which the journal has the answer"),
    ("prompt_sha256", "string", "the SHA-256 of the prompt's template"),
    ("brief_sha256", "string", "the SHA-256 of the brief in UTF-8"),
    ("brief_model", "string", "the model that wrote the brief"),
    ("brief_request_sha256", "string", "the SHA-256 of the request for it"),
    ("brief_prompt_sha256", "string", "the SHA-256 of that prompt's template"),
    ("licence", "string", "as the corpus or whoever exported it says, else `unknown`"),
    ("rules", "string", "the version of the gate: EnvCraft's, and a digest of the rules and the code that judged"),
    ("contract", "string", "what an environment has to promise"),
    ("contract_sha256", "string", "a digest of all that the contract promises"),
    ("budget", "string", "how much was played"),
    ("seed", "int64", "of the episodes"),
    ("sandbox", "string", "where it ran"),
    ("image", "string", "the container image's digest, else the versions of Python and the libraries"),
)


def rows(
    case: Case, judged: Sequence[Judged], cluster: int, brief: dict[str, Any], licences: Sequence[str]
) -> Iterator[tuple[str, Row]]:
    """The kind of each row of a concept, and the row; `brief` is the brief's provenance, `licences` are those of the
    attempts in `judged`.
    """
    task = _messages(code.asked(case))
    about = [_provenance(case, one, cluster, brief, own) for one, own in zip(judged, licences, strict=True)]
    passed = next((number for number, one in enumerate(judged) if one.passed), None)
    if passed is not None:
        good, known = judged[passed], about[passed]
        yield "code", {"messages": [*task, answer(good.attempt)], **known}
        if good.parent is not None:
            yield "repair", {**_repair(case, good), **known}
        seen = {good.attempt.source}
        for one, other in zip(judged, about, strict=True):
            # The same file is sometimes handed in twice.
            if one.attempt.source not in seen:
                seen.add(one.attempt.source)
                rejected = {"rejected": [answer(one.attempt)], **_rejected(one, other)}
                yield "preference", {"prompt": task, "chosen": [answer(good.attempt)], **rejected, **known}
    for one, own in zip(judged, about, strict=True):
        first = one.parent is None
        prompt = task if first else _messages(repair.asked(case, one.attempt.number))
        labelled = {"completion": [answer(one.attempt)], "label": one.passed, "reason": one.reason}
        yield "unpaired", {"prompt": prompt, **labelled, **own}


def columns(kind: str) -> tuple[Column, ...]:
    """All columns of a kind, in order."""
    return KINDS[kind][1] + PROVENANCE


def schema(kind: str) -> pyarrow.Schema:
    import pyarrow

    text = pyarrow.string()
    types = {
        "string": text,
        "int64": pyarrow.int64(),
        "bool": pyarrow.bool_(),
        "list<string>": pyarrow.list_(text),
        "list<message>": pyarrow.list_(pyarrow.struct([("role", text), ("content", text)])),
    }
    return pyarrow.schema([(name, types[what]) for name, what, _ in columns(kind)])


def _messages(asked: Iterable[tuple[str, str]]) -> list[dict[str, str]]:
    return [{"role": role, "content": text} for role, text in asked]


def answer(attempt: Attempt) -> dict[str, str]:
    """The file as the prompts want it: in one fence, which nothing in it ends."""
    longest = max((len(ticks) for ticks in re.findall("`{3,}", attempt.source)), default=2)
    fence = "`" * (longest + 1)
    return {"role": "assistant", "content": f"{fence}python\n{attempt.source.rstrip()}\n{fence}"}


def _repair(case: Case, good: Judged) -> Row:
    assert good.parent is not None
    asked = _messages(repair.asked(case, good.attempt.number))
    return {
        "messages": [*asked, answer(good.attempt)],
        "broken": good.parent.source,
        "findings": told(to_repair(good.parent.report), good.parent.source),
        "mended": good.attempt.source,
    }


def _rejected(one: Judged, about: Row) -> Row:
    same = {f"rejected_{name}": about[name] for name in ("attempt", "codes", "model", "request_sha256")}
    return {**same, "rejected_sha256": about["code_sha256"], "rejected_reason": one.reason}


def _provenance(case: Case, one: Judged, cluster: int, brief: dict[str, Any], licence: str) -> Row:
    """The values of :data:`PROVENANCE`."""
    attempt, parent, settings = one.attempt, one.parent, dict(one.settings)
    return {
        "concept": case.concept,
        "title": case.title,
        "cluster": cluster,
        "environment": one.published.name if one.published is not None and one.passed else None,
        "attempt": attempt.number,
        "code_sha256": sha256(attempt.source),
        "codes": _codes(attempt.report),
        "parent": None if parent is None else parent.number,
        "parent_sha256": None if parent is None else sha256(parent.source),
        "parent_codes": None if parent is None else _codes(parent.report),
        **_made(attempt.provenance, ""),
        "brief_sha256": sha256(case.brief),
        **_made(brief, "brief_"),
        "licence": licence,
        "sandbox": settings.pop("driver"),
        **settings,
    }


def _made(provenance: dict[str, Any], of: str) -> Row:
    """Which request to which model something comes from; None for what is not known."""
    told = {"model": "model", "request_sha256": "request", "prompt_sha256": "prompt"}
    return {f"{of}{name}": provenance.get(key) or None for name, key in told.items()}


def _codes(report: SubjectReport | None) -> list[str]:
    return sorted({finding.code for finding in findings(report)})
