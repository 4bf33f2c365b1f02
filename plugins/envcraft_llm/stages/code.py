"""Code: the brief as one file. What is cut off is continued; what is no file is asked for once more."""

from __future__ import annotations

from collections.abc import Callable

from envcraft.stages import Attempt, Case, Outcome, Question, Reply, Stage, Workbench
from envcraft_llm import extraction
from envcraft_llm.templates import Prompt, prompt

_TRIES = 2
#: So often a file that is cut off is continued.
_CONTINUED = 4


class Code(Stage):
    name = "code"
    summary = "The brief as a complete environment in one file."
    after = "viability"

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        template = prompt(self.name)
        messages = asked(case)
        text = ""
        for number in range(_TRIES):
            reply = await complete(case, bench, template, tuple(messages), self.name, 0)
            found = extraction.environment(reply.text)
            if found is not None:
                bench.keep_attempt(case, Attempt(0, found.source, found.name, provenance=reply.provenance))
                return Outcome("passed", facts={"lines": found.source.count("\n"), "tries": number + 1})
            text = reply.text
            messages += [("assistant", reply.text), ("user", template.fill("Again"))]
        begins = " ".join(text.split())[:80]
        return Outcome("failed", f"no code: nothing in the answer looks like an environment; it begins {begins!r}")


def asked(case: Case) -> list[tuple[str, str]]:
    """The request for the file of a brief."""
    template = prompt(Code.name)
    return [("system", template.fill("System")), ("user", template.fill("User", title=case.title, brief=case.brief))]


async def complete(
    case: Case,
    bench: Workbench,
    template: Prompt,
    messages: tuple[tuple[str, str], ...],
    stage: str,
    attempt: int,
    unfinished: Callable[[str], bool] = extraction.unfinished,
    sample: int = 0,
) -> Reply:
    """An answer, with its continuations where a limit cut it off or it stops within a fence."""
    reply = await bench.ask(case, Question(messages, stage, attempt, prompt=template.sha256, sample=sample))
    provenance, text = reply.provenance, reply.text
    requests = [provenance.get("request")]
    for _ in range(_CONTINUED):
        if not text.strip() or not (reply.cut or unfinished(text)):
            break
        further = (*messages, ("assistant", text), ("user", template.fill("Continue")))
        reply = await bench.ask(case, Question(further, stage, attempt, prompt=template.sha256, sample=sample))
        if not reply.text.strip():
            break
        text = extraction.joined(text, reply.text)
        requests.append(reply.provenance.get("request"))
    if len(requests) > 1:
        provenance = {**provenance, "continued": requests[1:]}
    return Reply(text, reply.cut, provenance)
