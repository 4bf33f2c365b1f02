"""Viability: a critique of the brief as JSON, validated against a schema."""

from __future__ import annotations

import json
import re
from itertools import islice
from typing import Any, Literal, get_args

import msgspec

from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome, StageRequest
from envcraft_llm.extraction import strip_markup
from envcraft_llm.templates import prompt

_TRIES = 2
_DECODER = json.JSONDecoder()
#: Number of opening braces that are tried as the start of the object.
_STARTS = 20
Kind = Literal[
    "impossible-physics", "contradictory-goals", "action-space-mismatch", "not-observable", "unbounded-scope"
]


class Objection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One objection to a brief: `quote` is a passage, `why` says what is wrong with it."""

    kind: Kind
    quote: str
    why: str


class Critique(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A critique of a brief. A viable brief may have objections too, as advice to the programmer."""

    viable: bool
    objections: list[Objection]
    summary: str


#: The schema of the critique. Written by hand, since endpoints support only simple schemas.
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
    summary = "A critique of the brief: physics, goals, controls, observability, scope."
    after = "briefs"

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        template = prompt(self.name)
        messages = [("system", template.fill("System")), ("user", template.fill("User", brief=state.brief))]
        problem = ""
        for number in range(_TRIES):
            question = StageRequest(tuple(messages), self.name, number, schema=SCHEMA, prompt=template.sha256)
            reply = await context.generate(state, question)
            try:
                critique = read(reply.text)
            except ValueError as error:
                problem = str(error)
                messages += [("assistant", reply.text), ("user", template.fill("Again", complaint=problem))]
                continue
            facts = {**msgspec.to_builtins(critique), **reply.provenance}
            if critique.viable:
                return StageOutcome("passed", facts=facts)
            first = critique.objections[0]
            return StageOutcome("rejected", f"{first.kind}: {critique.summary or first.why}", facts)
        return StageOutcome("failed", f"no verdict: {problem}", {"tries": _TRIES})


def read(text: str) -> Critique:
    """Extract the critique from prose and fences.

    Raises:
        ValueError: If there is no valid critique; the message is part of the retry prompt.
    """
    text = strip_markup(text)
    problem = "there is no JSON object in the answer"
    for mark in islice(re.finditer(r"\{", text), _STARTS):
        try:
            value, _ = _DECODER.raw_decode(text, mark.start())
        except ValueError as error:
            problem = f"the JSON cannot be read: {error}"
            continue
        except RecursionError:
            problem = "the JSON cannot be read: it is nested too deeply"
            continue
        try:
            critique = msgspec.convert(value, Critique)
        except msgspec.ValidationError as error:
            raise ValueError(f"the JSON object does not have the requested form: {error}") from None
        if not critique.viable and not critique.objections:
            raise ValueError("the verdict contradicts itself: it is not viable, and has no objections")
        return critique
    raise ValueError(problem)
