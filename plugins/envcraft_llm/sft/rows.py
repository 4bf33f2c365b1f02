"""The rows of a concept, in the conversational formats of TRL [1]_.

The prompt of a row is the prompt that the pipeline sends, and its completion is one file in one fence.

.. [1] https://huggingface.co/docs/trl/dataset_formats
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from envcraft.generation.stages import Attempt, ConceptState
from envcraft.model.verdict import SubjectReport
from envcraft_llm.findings import findings, findings_markdown, to_repair
from envcraft_llm.stages import code, repair

from .labels import LabelledAttempt, sha256

if TYPE_CHECKING:
    import pyarrow

Column = tuple[str, str, str]
Row = dict[str, Any]
#: The kinds of rows: description, and columns with name, type and description.
KINDS: dict[str, tuple[str, tuple[Column, ...]]] = {
    "code": (
        "a brief, and a validated environment of it",
        (("messages", "list<message>", "system, user (the brief), assistant (the file)"),),
    ),
    "repair": (
        "a broken attempt with the findings of the checks in words, and the validated environment that it became",
        (
            ("messages", "list<message>", "system, user (brief, broken file, findings), assistant (the repaired file)"),
            ("broken", "string", "the file that is repaired"),
            ("findings", "string", "the findings in it, as the request contains them"),
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
            ("rejected_codes", "list<string>", "the codes of the findings in it"),
            ("rejected_reason", "string", "why it did not pass"),
            ("rejected_model", "string", "the model that wrote it"),
            ("rejected_request_sha256", "string", "the SHA-256 of the request for it"),
        ),
    ),
    "unpaired": (
        "every attempt with a complete verdict, and whether it passed",
        (
            ("prompt", "list<message>", "system, user: the brief, or for a repair its request"),
            ("completion", "list<message>", "assistant: the file"),
            ("label", "bool", "whether it became a validated environment"),
            ("reason", "string", "why not; empty if it did"),
        ),
    ),
}
#: Columns of every row, about the attempt in its completion. No trainer uses a column of these names.
PROVENANCE: tuple[Column, ...] = (
    ("concept", "string", "the id of the concept"),
    ("title", "string", "the title of the game"),
    ("cluster", "int64", "rows with the same number are of concepts with near-duplicate sources, and in one split"),
    ("environment", "string", "the name of the validated environment in the corpus"),
    ("attempt", "int64", "the number of the attempt: 0 is the first, then repairs"),
    ("code_sha256", "string", "the SHA-256 of its file in UTF-8"),
    ("codes", "list<string>", "the codes of the findings in it"),
    ("parent", "int64", "the number of the attempt that it repairs"),
    ("parent_sha256", "string", "the SHA-256 of that one's file"),
    ("parent_codes", "list<string>", "the codes of the findings in that one"),
    ("model", "string", "the model that wrote it, by the name in the request"),
    ("request_sha256", "string", "the SHA-256 of the request, which is its key in the journal"),
    ("prompt_sha256", "string", "the SHA-256 of the prompt's template"),
    ("brief_sha256", "string", "the SHA-256 of the brief in UTF-8"),
    ("brief_model", "string", "the model that wrote the brief"),
    ("brief_request_sha256", "string", "the SHA-256 of the request for it"),
    ("brief_prompt_sha256", "string", "the SHA-256 of that prompt's template"),
    ("licence", "string", "as the corpus or the export command states, else `unknown`"),
    ("rules", "string", "the version of EnvCraft, and a digest of the rules and the code that judged"),
    ("contract", "string", "the contract that the environment fulfils"),
    ("contract_sha256", "string", "a digest of the contract"),
    ("budget", "string", "the budget of the checks"),
    ("seed", "int64", "the seed of the episodes"),
    ("sandbox", "string", "the sandbox in which it ran"),
    ("image", "string", "the container image's digest, else the versions of Python and the libraries"),
)


def rows(
    state: ConceptState,
    labelled: Sequence[LabelledAttempt],
    cluster: int,
    brief: dict[str, Any],
    licences: Sequence[str],
) -> Iterator[tuple[str, Row]]:
    """Yield the kind and the content of each row of a concept.

    Args:
        state: The concept.
        labelled: Its attempts with a label.
        cluster: Number of its cluster.
        brief: Provenance of its brief.
        licences: Licences of the attempts.
    """
    task = _messages(code.request_messages(state))
    about = [_provenance(state, one, cluster, brief, own) for one, own in zip(labelled, licences, strict=True)]
    passed = next((number for number, one in enumerate(labelled) if one.passed), None)
    if passed is not None:
        good, known = labelled[passed], about[passed]
        yield "code", {"messages": [*task, answer(good.attempt)], **known}
        if good.parent is not None:
            yield "repair", {**_repair(state, good), **known}
        seen = {good.attempt.source}
        for one, other in zip(labelled, about, strict=True):
            # A model sometimes writes the same file twice.
            if one.attempt.source not in seen:
                seen.add(one.attempt.source)
                rejected = {"rejected": [answer(one.attempt)], **_rejected(one, other)}
                yield "preference", {"prompt": task, "chosen": [answer(good.attempt)], **rejected, **known}
    for one, own in zip(labelled, about, strict=True):
        first = one.parent is None
        prompt = task if first else _messages(repair.request_messages(state, one.attempt.number))
        completion = {"completion": [answer(one.attempt)], "label": one.passed, "reason": one.reason}
        yield "unpaired", {"prompt": prompt, **completion, **own}


def columns(kind: str) -> tuple[Column, ...]:
    """Return all columns of a kind, in order."""
    return KINDS[kind][1] + PROVENANCE


def schema(kind: str) -> pyarrow.Schema:
    """Return the parquet schema of a kind."""
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


def _messages(messages: Iterable[tuple[str, str]]) -> list[dict[str, str]]:
    return [{"role": role, "content": text} for role, text in messages]


def answer(attempt: Attempt) -> dict[str, str]:
    """Return the file as a message with one fence that is longer than any fence in the file."""
    longest = max((len(ticks) for ticks in re.findall("`{3,}", attempt.source)), default=2)
    fence = "`" * (longest + 1)
    return {"role": "assistant", "content": f"{fence}python\n{attempt.source.rstrip()}\n{fence}"}


def _repair(state: ConceptState, good: LabelledAttempt) -> Row:
    assert good.parent is not None
    messages = _messages(repair.request_messages(state, good.attempt.number))
    return {
        "messages": [*messages, answer(good.attempt)],
        "broken": good.parent.source,
        "findings": findings_markdown(to_repair(good.parent.report), good.parent.source),
        "mended": good.attempt.source,
    }


def _rejected(one: LabelledAttempt, about: Row) -> Row:
    same = {f"rejected_{name}": about[name] for name in ("attempt", "codes", "model", "request_sha256")}
    return {**same, "rejected_sha256": about["code_sha256"], "rejected_reason": one.reason}


def _provenance(state: ConceptState, one: LabelledAttempt, cluster: int, brief: dict[str, Any], licence: str) -> Row:
    """The values of :data:`PROVENANCE`."""
    attempt, parent, settings = one.attempt, one.parent, dict(one.settings)
    return {
        "concept": state.concept,
        "title": state.title,
        "cluster": cluster,
        "environment": one.published.name if one.published is not None and one.passed else None,
        "attempt": attempt.number,
        "code_sha256": sha256(attempt.source),
        "codes": _codes(attempt.report),
        "parent": None if parent is None else parent.number,
        "parent_sha256": None if parent is None else sha256(parent.source),
        "parent_codes": None if parent is None else _codes(parent.report),
        **_made(attempt.provenance, ""),
        "brief_sha256": sha256(state.brief),
        **_made(brief, "brief_"),
        "licence": licence,
        "sandbox": settings.pop("driver"),
        **settings,
    }


def _made(provenance: dict[str, Any], of: str) -> Row:
    """The model, the request and the prompt of a text; None if unknown."""
    keys = {"model": "model", "request_sha256": "request", "prompt_sha256": "prompt"}
    return {f"{of}{name}": provenance.get(key) or None for name, key in keys.items()}


def _codes(report: SubjectReport | None) -> list[str]:
    return sorted({finding.code for finding in findings(report)})
