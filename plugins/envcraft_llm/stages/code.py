"""Code: the brief as one file, with continuations of a completion that is cut off, and one retry without a file."""

from __future__ import annotations

from envcraft.generation.stages import (
    Attempt,
    ConceptState,
    Stage,
    StageContext,
    StageOutcome,
    StageReply,
    StageRequest,
)
from envcraft_llm import extraction
from envcraft_llm.templates import Prompt, prompt

_TRIES = 2
#: Number of continuations of a completion that is cut off.
_CONTINUATIONS = 4


class Code(Stage):
    name = "code"
    summary = "The brief as a complete environment in one file."
    after = "viability"

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        template = prompt(self.name)
        messages = request_messages(state)
        text = ""
        for number in range(_TRIES):
            reply = await complete(state, context, template, tuple(messages), self.name, 0)
            file = extraction.environment(reply.text)
            if file is not None:
                context.keep_attempt(state, Attempt(0, file.source, file.name, provenance=reply.provenance))
                return StageOutcome("passed", facts={"lines": file.source.count("\n"), "tries": number + 1})
            text = reply.text
            messages += [("assistant", reply.text), ("user", template.fill("Again"))]
        begins = " ".join(text.split())[:80]
        return StageOutcome("failed", f"no code: nothing in the answer looks like an environment; it begins {begins!r}")


def request_messages(state: ConceptState) -> list[tuple[str, str]]:
    """Return the messages that request the code of a brief."""
    template = prompt(Code.name)
    return [("system", template.fill("System")), ("user", template.fill("User", title=state.title, brief=state.brief))]


async def complete(
    state: ConceptState,
    context: StageContext,
    template: Prompt,
    messages: tuple[tuple[str, str], ...],
    stage: str,
    attempt: int,
    sample: int = 0,
) -> StageReply:
    """Return a completion, joined with its continuations if a token limit or an open fence shows that it is cut off.

    Args:
        state: The concept.
        context: Services of the stage.
        template: The template of the messages; its part ``Continue`` requests a continuation.
        messages: The conversation so far.
        stage: Name of the stage.
        attempt: Number of the attempt at the concept.
        sample: Distinguishes requests that are otherwise equal.
    """
    reply = await context.generate(state, StageRequest(messages, stage, attempt, prompt=template.sha256, sample=sample))
    provenance, text = reply.provenance, reply.text
    requests = [provenance.get("request")]
    for _ in range(_CONTINUATIONS):
        if not text.strip() or not (reply.cut or extraction.is_unfinished(text)):
            break
        further = (*messages, ("assistant", text), ("user", template.fill("Continue")))
        reply = await context.generate(
            state, StageRequest(further, stage, attempt, prompt=template.sha256, sample=sample)
        )
        if not reply.text.strip():
            break
        text = extraction.join(text, reply.text)
        requests.append(reply.provenance.get("request"))
    if len(requests) > 1:
        provenance = {**provenance, "continued": requests[1:]}
    return StageReply(text, reply.cut, provenance)
