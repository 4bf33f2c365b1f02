"""Viability: a critique of the brief with a verdict in a fixed form, checked on this side."""

from __future__ import annotations

import json
import re
from itertools import islice
from typing import Any, Literal, get_args

import msgspec

from envcraft.stages import Case, Outcome, Question, Stage, Workbench
from envcraft_llm.extraction import clean
from envcraft_llm.templates import prompt

_TRIES = 2
_DECODER = json.JSONDecoder()
#: So many braces may begin the object.
_BEGINNINGS = 20
Kind = Literal[
    "impossible-physics", "contradictory-goals", "action-space-mismatch", "not-observable", "unbounded-scope"
]


class Objection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One reason against a brief: `quote` is what it says, `why` what is wrong with that."""

    kind: Kind
    quote: str
    why: str


class Critique(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is said of a brief. One that is viable may have objections, too: what a programmer is to mind."""

    viable: bool
    objections: list[Objection]
    summary: str


#: The form of the answer. Written out, since endpoints know only the plainest schemas.
SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "viable": {"type": "boolean"},
        "objections": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "kind": {"type": "string", "enum": list(get_args(Kind))},
                    "quote": {"type": "string"},
                    "why": {"type": "string"},
                },
                "required": ["kind", "quote", "why"],
                "additionalProperties": False,
            },
        },
        "summary": {"type": "string"},
    },
    "required": ["viable", "objections", "summary"],
    "additionalProperties": False,
}


class Viability(Stage):
    name = "viability"
    summary = "A critique of the brief: physics, goals, controls, what can be seen, scope."
    after = "briefs"

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        template = prompt(self.name)
        messages = [("system", template.fill("System")), ("user", template.fill("User", brief=case.brief))]
        wrong = ""
        for number in range(_TRIES):
            question = Question(tuple(messages), self.name, number, schema=SCHEMA, prompt=template.sha256)
            reply = await bench.ask(case, question)
            try:
                critique = read(reply.text)
            except ValueError as error:
                wrong = str(error)
                messages += [("assistant", reply.text), ("user", template.fill("Again", complaint=wrong))]
                continue
            facts = {**msgspec.to_builtins(critique), **reply.provenance}
            if critique.viable:
                return Outcome("passed", facts=facts)
            first = critique.objections[0]
            return Outcome("rejected", f"{first.kind}: {critique.summary or first.why}", facts)
        return Outcome("failed", f"no verdict: {wrong}", {"tries": _TRIES})


def read(text: str) -> Critique:
    """The critique in an answer, out of prose and fences. Raises ValueError, in words for who wrote it."""
    text = clean(text)
    wrong = "there is no JSON object in the answer"
    for mark in islice(re.finditer(r"\{", text), _BEGINNINGS):
        try:
            value, _ = _DECODER.raw_decode(text, mark.start())
        except ValueError as error:
            wrong = f"the JSON cannot be read: {error}"
            continue
        except RecursionError:
            wrong = "the JSON cannot be read: it is nested too deeply"
            continue
        try:
            critique = msgspec.convert(value, Critique)
        except msgspec.ValidationError as error:
            raise ValueError(f"the JSON object is not of the form that is asked for: {error}") from None
        if not critique.viable and not critique.objections:
            raise ValueError("the verdict contradicts itself: it is not viable, and has no objections")
        return critique
    raise ValueError(wrong)
