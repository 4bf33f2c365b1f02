"""The stages that write, their order and their prompts, with a model that says what the test wants."""

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
from envcraft.stages import Case, Outcome, Reply, Stage, Workbench, ordered

from .content import GAME, brief, elaboration, verdict
from .scripted import ScriptedBench, case, fenced, run

# Elaboration


def test_a_brief_is_written_from_the_elaborated_concept() -> None:
    about, bench = case(), ScriptedBench([elaboration(), brief()])
    assert run(Briefs(), about, ScriptedBench([brief()])).result == "passed"
    about.brief = ""
    about.outcomes["elaboration"] = run(Elaboration(), about, bench)
    assert about.outcomes["elaboration"].facts["text"] == elaboration()
    assert run(Briefs(), about, bench).result == "passed"
    assert about.idea in bench.asked[0].messages[1][1]
    assert elaboration() in bench.asked[1].messages[1][1]


def test_an_elaboration_is_asked_for_once_more_with_the_complaint() -> None:
    about = Case("c0", "Errand", "Carry 12 keys over 1,000 steps, 3 at a time.")
    for answer, words in (
        (elaboration("12 keys, 1000 steps"), "Numbers of the concept are missing: 3."),
        (elaboration("12, 3, 1,000").replace("Loss:", "Lost:"), "There is no part that begins with `Loss:`."),
        (elaboration("12, 3, 1,000").replace("Win:", "Rules:", 1), "no part that begins with `Win:`"),
        ("Win: 12.\n" + elaboration("3 and 1000"), "The parts are not in the order"),
        (elaboration("12, 3, 1,000", 100), "words; it has to have 200 to 800"),
    ):
        bench = ScriptedBench([answer, elaboration("12, 3, **1,000**")])
        outcome = run(Elaboration(), about, bench)
        assert (outcome.result, outcome.facts["tries"]) == ("passed", 2)
        assert words in bench.asked[1].messages[-1][1]


def test_a_concept_that_cannot_be_elaborated_fails_with_the_reason() -> None:
    outcome = run(Elaboration(), case(), ScriptedBench(["No."]))
    assert outcome.result == "failed"
    assert outcome.reason.startswith("no elaboration: There is no part that begins with `Controls:`.")


def test_what_has_a_brief_is_not_elaborated() -> None:
    bench = ScriptedBench([])
    assert run(Elaboration(), case(brief=brief()), bench).result == "passed"
    assert not bench.asked


# Briefs


def test_a_brief_that_is_good_is_kept_as_it_is() -> None:
    about, bench = case(), ScriptedBench([f"Of course!\n\n{brief()}"])
    assert run(Briefs(), about, bench).result == "passed"
    assert about.brief.strip() == brief().strip()
    assert len(bench.asked) == 1


def test_a_brief_is_asked_for_once_more_with_the_complaint() -> None:
    about, bench = case(), ScriptedBench([brief(words=900), brief()])
    assert run(Briefs(), about, bench).facts["tries"] == 2
    roles = [role for role, _ in bench.asked[1].messages]
    assert roles == ["system", "user", "assistant", "user"]
    assert "it has to have 1,500 to 3,000" in bench.asked[1].messages[-1][1]


def test_a_brief_that_stays_bad_is_a_failure_with_its_reason() -> None:
    outcome = run(Briefs(), case(), ScriptedBench(["I cannot do that."]))
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
        (brief().replace("## Controls", "## Input"), "`## Input` that is not asked for"),
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
def test_what_is_wrong_with_a_brief(text: str, words: str | None) -> None:
    found = complaints(tidy(text))
    assert any(words in one for one in found) if words else not found


def test_a_line_of_spaces_takes_no_time() -> None:
    began = time.process_time()
    assert complaints("# Errand" + " " * 60_000 + "x\n")
    assert time.process_time() - began < 2


def test_a_section_of_nothing_is_told_of() -> None:
    place = brief().index("## Rewards")
    end = brief().index("## Termination")
    emptied = brief(words=2000)[:0] + brief()[:place] + "## Rewards\n\nSome points.\n\n" + brief()[end:]
    assert any("`## Rewards` has fewer than 15 words" in one for one in complaints(emptied))


@pytest.mark.parametrize(
    "text",
    [f"```markdown\n{brief()}```", f"<think># Plan\n</think>{brief()}", f"<|channel|>final<|message|>{brief()}<|end|>"],
)
def test_a_brief_comes_out_of_its_wrapping(text: str) -> None:
    assert tidy(text).strip() == brief().strip()


def test_words_are_what_spaces_part() -> None:
    assert count("## The *guard*: 3 | 4.5\n- a 10x10 board\n") == 10


# Viability


def test_viable() -> None:
    assert run(Viability(), case(brief=brief()), ScriptedBench([verdict()])).result == "passed"
    with_reservations = ScriptedBench([verdict(False).replace("false", "true")])
    assert run(Viability(), case(brief=brief()), with_reservations).result == "passed"


def test_what_is_not_viable_keeps_its_reason() -> None:
    outcome = run(Viability(), case(brief=brief()), ScriptedBench([f"```json\n{verdict(False)}\n```"]))
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
def test_a_verdict_of_another_form_is_refused(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        read(text)


def test_an_answer_of_braces_is_read_and_refused() -> None:
    with pytest.raises(ValueError, match="the JSON cannot be read"):
        read("{" * 100_000)
    with pytest.raises(ValueError, match="nested too deeply"):
        read('{"viable": ' + "[" * 100_000)


def test_a_verdict_is_asked_for_once_more() -> None:
    bench = ScriptedBench(["Fine!", f"I think {{so}}: {verdict()}"])
    assert run(Viability(), case(brief=brief()), bench).result == "passed"
    assert bench.asked[0].schema == SCHEMA
    assert run(Viability(), case(brief=brief()), ScriptedBench(["Fine!"])).reason.startswith("no verdict: ")


def test_the_schema_takes_what_is_read() -> None:
    import jsonschema

    for text in (verdict(), verdict(False)):
        jsonschema.validate(json.loads(text), SCHEMA)


# Code


def test_code_that_is_cut_off_is_continued() -> None:
    cut = fenced(GAME)[:1500]
    bench = ScriptedBench([Reply(cut, cut=True, provenance={"request": "1"}), Reply(fenced(GAME)[1450:])])
    about = case(brief=brief())
    assert run(Code(), about, bench).result == "passed"
    assert about.attempts[0].source == GAME
    assert bench.asked[1].messages[-2:] == (("assistant", cut), ("user", prompt("code").fill("Continue")))
    assert "continued" in about.attempts[0].provenance


def test_what_is_no_code_is_asked_for_once_more_and_then_failed() -> None:
    bench = ScriptedBench(["I would rather not."])
    outcome = run(Code(), case(brief=brief()), bench)
    assert outcome.result == "failed"
    assert outcome.reason.startswith("no code: ")
    assert len(bench.asked) == 2


# Order, prompts


class _Extra(Stage):
    name, summary = "extra", "One more."

    def __init__(self, after: str = "", replaces: str = "", name: str = "extra") -> None:
        self.after, self.replaces, self.name = after, replaces, name

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        return Outcome("passed")


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
def test_a_stage_that_has_no_place_is_refused(extra: Stage) -> None:
    with pytest.raises(UsageError, match="extra"):
        ordered([*(kind() for kind in STAGES), extra])


def test_what_is_filled_in_is_not_looked_at_again() -> None:
    assert "{{source}}" in prompt("viability").fill("User", brief="A brief with {{source}} in it.")


STAGES_ASKING = ("elaboration", "briefs", "viability", "code", "repair", "privileged")


def test_every_prompt_says_what_the_contract_and_the_form_are() -> None:
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
