"""The stages that write, their order and their prompts, with scripted completions."""

from __future__ import annotations

import json
import re
import time

import pytest
from envcraft_llm.stages import STAGES, Briefs, Code, Elaboration, Viability
from envcraft_llm.stages.briefs import SECTIONS, complaints, count, tidy
from envcraft_llm.stages.elaboration import PARTS
from envcraft_llm.stages.viability import SCHEMA, read
from envcraft_llm.templates import FOLDER, prompt

from envcraft.errors import UsageError
from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome, StageReply
from envcraft.model.stage_order import ordered

from .content import GAME, brief, elaboration, verdict
from .scripted import ScriptedContext, fenced, run, state

# Elaboration


def test_a_brief_is_written_from_the_elaborated_concept() -> None:
    about, context = state(), ScriptedContext([elaboration(), brief()])
    assert run(Briefs(), about, ScriptedContext([brief()])).result == "passed"
    about.brief = ""
    about.outcomes["elaboration"] = run(Elaboration(), about, context)
    assert about.outcomes["elaboration"].facts["text"] == elaboration()
    assert run(Briefs(), about, context).result == "passed"
    assert about.idea in context.requests[0].messages[1][1]
    assert elaboration() in context.requests[1].messages[1][1]


def test_an_elaboration_is_retried_with_the_complaint() -> None:
    about = ConceptState("c0", "Errand", "Carry 12 keys over 1,000 steps, 3 at a time.")
    for answer, words in (
        (elaboration("12 keys, 1000 steps"), "Numbers of the concept are missing: 3."),
        (elaboration("12, 3, 1,000").replace("Loss:", "Lost:"), "There is no part that begins with `Loss:`."),
        (elaboration("12, 3, 1,000").replace("Win:", "Rules:", 1), "no part that begins with `Win:`"),
        ("Win: 12.\n" + elaboration("3 and 1000"), "The parts are not in the order"),
        (elaboration("12, 3, 1,000", 100), "words; it has to have 200 to 800"),
    ):
        context = ScriptedContext([answer, elaboration("12, 3, **1,000**")])
        outcome = run(Elaboration(), about, context)
        assert (outcome.result, outcome.facts["tries"]) == ("passed", 2)
        assert words in context.requests[1].messages[-1][1]


def test_a_concept_that_cannot_be_elaborated_fails_with_the_reason() -> None:
    outcome = run(Elaboration(), state(), ScriptedContext(["No."]))
    assert outcome.result == "failed"
    assert outcome.reason.startswith("no elaboration: There is no part that begins with `Controls:`.")


def test_a_concept_with_a_brief_is_not_elaborated() -> None:
    context = ScriptedContext([])
    assert run(Elaboration(), state(brief=brief()), context).result == "passed"
    assert not context.requests


# Briefs


def test_a_valid_brief_is_stored() -> None:
    about, context = state(), ScriptedContext([f"Of course!\n\n{brief()}"])
    assert run(Briefs(), about, context).result == "passed"
    assert about.brief.strip() == brief().strip()
    assert len(context.requests) == 1


def test_a_brief_is_retried_with_the_complaint() -> None:
    about, context = state(), ScriptedContext([brief(words=900), brief()])
    assert run(Briefs(), about, context).facts["tries"] == 2
    roles = [role for role, _ in context.requests[1].messages]
    assert roles == ["system", "user", "assistant", "user"]
    assert "it has to have 1,500 to 3,000" in context.requests[1].messages[-1][1]


def test_a_brief_that_stays_invalid_fails_with_the_reason() -> None:
    outcome = run(Briefs(), state(), ScriptedContext(["I cannot do that."]))
    assert outcome.result == "failed"
    assert "The section `## Premise` is missing." in outcome.reason


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (brief(words=1505), None),
        (brief(words=2970), None),
        (brief(words=1400), "words; it has to have"),
        (brief(words=3100), "words; it has to have"),
        (brief().replace("# Errand\n", "", 1), "level-1 heading that gives the title"),
        (brief().replace("## Controls", "## Input"), "`## Controls` is missing"),
        (brief().replace("## Controls", "## Input"), "`## Input` that was not requested"),
        (
            brief()
            .replace("## Rewards", "## Swap")
            .replace("## Controls", "## Rewards")
            .replace("## Swap", "## Controls"),
            "order",
        ),
        (brief().replace("## Premise", "### Premise"), "`## Premise` is missing"),
        (brief() + "\n# Appendix\n", "more than one level-1"),
        (brief().replace("## Premise\n", "## Premise\n\n### The guard\n"), None),
        (brief().replace("## Premise\n", "## Premise\n\nIt.\n\n## Premise\n"), "order"),
        (brief().replace("## Premise", "## Premise ##"), None),
    ],
)
def test_complaints_about_a_brief(text: str, words: str | None) -> None:
    found = complaints(tidy(text))
    assert any(words in one for one in found) if words else not found


def test_a_line_of_spaces_is_parsed_in_linear_time() -> None:
    began = time.process_time()
    assert complaints("# Errand" + " " * 60_000 + "x\n")
    assert time.process_time() - began < 2


def test_an_empty_section_is_a_complaint() -> None:
    place = brief().index("## Rewards")
    end = brief().index("## Termination")
    emptied = brief(words=2000)[:0] + brief()[:place] + "## Rewards\n\nSome points.\n\n" + brief()[end:]
    assert any("`## Rewards` has fewer than 15 words" in one for one in complaints(emptied))


@pytest.mark.parametrize(
    "text",
    [f"```markdown\n{brief()}```", f"<think># Plan\n</think>{brief()}", f"<|channel|>final<|message|>{brief()}<|end|>"],
)
def test_a_brief_is_unwrapped(text: str) -> None:
    assert tidy(text).strip() == brief().strip()


def test_words_are_separated_by_white_space() -> None:
    assert count("## The *guard*: 3 | 4.5\n- a 10x10 board\n") == 10


# Viability


def test_viable() -> None:
    assert run(Viability(), state(brief=brief()), ScriptedContext([verdict()])).result == "passed"
    with_reservations = ScriptedContext([verdict(False).replace("false", "true")])
    assert run(Viability(), state(brief=brief()), with_reservations).result == "passed"


def test_an_unviable_brief_is_rejected_with_the_reason() -> None:
    outcome = run(Viability(), state(brief=brief()), ScriptedContext([f"```json\n{verdict(False)}\n```"]))
    assert outcome.result == "rejected"
    assert outcome.reason == "impossible-physics: An errand."
    assert outcome.facts["objections"][0]["quote"] == "one cell in 3 steps"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("It is fine.", "no JSON object"),
        ('{"viable": true', "cannot be read"),
        ('{"viable": "yes", "objections": [], "summary": ""}', "`$.viable`"),
        ('{"viable": true, "summary": ""}', "objections"),
        ('{"viable": false, "objections": [], "summary": ""}', "contradicts"),
        (verdict(False).replace("impossible-physics", "boring"), "$.objections[0].kind"),
    ],
)
def test_an_invalid_critique_is_rejected(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        read(text)


def test_a_completion_of_braces_is_rejected() -> None:
    with pytest.raises(ValueError, match="the JSON cannot be read"):
        read("{" * 100_000)
    with pytest.raises(ValueError, match="nested too deeply"):
        read('{"viable": ' + "[" * 100_000)


def test_a_critique_is_retried() -> None:
    context = ScriptedContext(["Fine!", f"I think {{so}}: {verdict()}"])
    assert run(Viability(), state(brief=brief()), context).result == "passed"
    assert context.requests[0].schema == SCHEMA
    assert run(Viability(), state(brief=brief()), ScriptedContext(["Fine!"])).reason.startswith("no verdict: ")


def test_the_schema_matches_the_critique() -> None:
    import jsonschema

    for text in (verdict(), verdict(False)):
        jsonschema.validate(json.loads(text), SCHEMA)


# Code


def test_code_that_is_cut_off_is_continued() -> None:
    cut = fenced(GAME)[:1500]
    context = ScriptedContext([StageReply(cut, cut=True, provenance={"request": "1"}), StageReply(fenced(GAME)[1450:])])
    about = state(brief=brief())
    assert run(Code(), about, context).result == "passed"
    assert about.attempts[0].source == GAME
    assert context.requests[1].messages[-2:] == (("assistant", cut), ("user", prompt("code").fill("Continue")))
    assert "continued" in about.attempts[0].provenance


def test_a_completion_without_code_is_retried_once() -> None:
    context = ScriptedContext(["I would rather not."])
    outcome = run(Code(), state(brief=brief()), context)
    assert outcome.result == "failed"
    assert outcome.reason.startswith("no code: ")
    assert len(context.requests) == 2


# Order, prompts


class _Extra(Stage):
    name, summary = "extra", "One more."

    def __init__(self, after: str = "", replaces: str = "", name: str = "extra") -> None:
        self.after, self.replaces, self.name = after, replaces, name

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        return StageOutcome("passed")


NAMES = ["concepts", "briefs", "viability", "code", "repair", "instawin", "instadeath", "privileged", "validated"]


@pytest.mark.parametrize(
    ("extra", "names"),
    [
        ([], NAMES),
        ([Elaboration()], [NAMES[0], "elaboration", *NAMES[1:]]),
        ([_Extra("briefs")], [*NAMES[:2], "extra", *NAMES[2:]]),
        ([_Extra("validated")], [*NAMES, "extra"]),
        ([_Extra(replaces="viability")], [*NAMES[:2], "extra", *NAMES[3:]]),
        ([_Extra("code", name="a"), _Extra("code", name="b")], [*NAMES[:4], "a", "b", *NAMES[4:]]),
    ],
)
def test_stages_run_in_their_order(extra: list[Stage], names: list[str]) -> None:
    assert [stage.name for stage in ordered([*(kind() for kind in STAGES), *extra])] == names


@pytest.mark.parametrize("extra", [_Extra("nowhere"), _Extra(replaces="nothing"), _Extra("extra")])
def test_stages_with_invalid_places_are_rejected(extra: Stage) -> None:
    with pytest.raises(UsageError, match="extra"):
        ordered([*(kind() for kind in STAGES), extra])


def test_values_are_not_expanded_again() -> None:
    assert "{{source}}" in prompt("viability").fill("User", brief="A brief with {{source}} in it.")


STAGES_ASKING = ("elaboration", "briefs", "viability", "code", "repair", "privileged")


def test_every_prompt_states_contract_and_format() -> None:
    for section in SECTIONS:
        assert f"`## {section}`" in prompt("briefs").parts["User"]
    for part in PARTS:
        assert f"`{part}:`" in prompt("elaboration").parts["User"]
    for stage in ("code", "repair"):
        assert "MultiDiscrete([5, 2, 2])" in prompt(stage).parts["System"]
        assert "What goes wrong most often" in prompt(stage).parts["System"]
    assert len({prompt(stage).sha256 for stage in STAGES_ASKING}) == len(STAGES_ASKING)
    assert {file.stem for file in FOLDER.glob("*.md")} == {
        *STAGES_ASKING,
        "contract",
        "defects",
    }
