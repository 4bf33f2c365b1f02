"""The stages that judge and repair, with scripted completions and verdicts."""

from __future__ import annotations

import pytest
from envcraft_llm.stages import Instawin, Privileged, Repair, Validated

from envcraft.generation.stages import Attempt, ConceptState, PolicyEvaluation, Stage, StageOutcome
from envcraft.model.verdict import Finding, Verdict

from .content import GAME, GUTTED, IDLE, POLICY, brief
from .scripted import ScriptedContext, fenced, finding, report, run, state

# Repair


def judged(source: str) -> list[Finding]:
    return [finding("EC107", "step() raises IndexError", 40, traceback="line 40")] if "BAD" in source else []


BAD = GAME.replace("LIMIT = 200", "LIMIT = 200  # BAD")


def repaired(*answers: str, first: str = BAD) -> tuple[StageOutcome, ConceptState, ScriptedContext]:
    about = state(brief=brief(), attempts=[Attempt(0, first)])
    context = ScriptedContext([fenced(answer) for answer in answers], judged)
    return run(Repair(), about, context), about, context


def test_a_file_without_findings_is_not_repaired() -> None:
    outcome, _, context = repaired(GAME, first=GAME)
    assert outcome == StageOutcome("passed", facts={"attempt": 0})
    assert not context.requests


def test_the_repair_prompt_is_complete() -> None:
    outcome, about, context = repaired(GAME)
    assert outcome.facts["attempt"] == 1
    said = context.requests[0].messages[1][1]
    for words in (
        brief().strip(),
        BAD.strip(),
        "EC107 (step-raises)",
        "step() raises IndexError",
        "Fix the line that raises",
        "  40>",
        "reset(seed=3)",
        "[[1, 0, 0], [4, 1, 0]]",
        "What was raised:\n\n```\nline 40",
        "repair 1 of 3",
    ):
        assert words in said
    assert "-LIMIT = 200  # BAD" in about.attempts[1].diff
    assert "+LIMIT = 200" in about.attempts[1].diff


def test_at_most_three_repairs() -> None:
    outcome, about, context = repaired(BAD.replace("DOOR_PAY = 10.0", "DOOR_PAY = 9.0"))
    assert outcome.result == "rejected"
    assert outcome.reason.startswith("unfixable: EC107 step() raises IndexError")
    assert (len(context.requests), len(about.attempts)) == (3, 4)


def test_a_degenerate_repair_is_rejected_with_the_reason() -> None:
    outcome, about, context = repaired(GUTTED, GAME)
    assert outcome == StageOutcome("passed", facts={"attempt": 2})
    assert about.attempts[1].degenerate
    assert "The repair before was refused" in context.requests[1].messages[1][1]
    # It goes on from what stood before.
    assert "# BAD" in context.requests[1].messages[1][1]


def test_only_degenerate_repairs_pass() -> None:
    outcome, about, _ = repaired(GUTTED)
    assert outcome.reason.startswith("gutted: attempt 1 passes by doing less")
    assert about.best is about.attempts[0]


def test_a_completion_without_a_file_counts_as_a_repair() -> None:
    outcome, about, context = repaired("", GAME)
    assert outcome == StageOutcome("passed", facts={"attempt": 2})
    assert "The answer before had no complete file in it." in context.requests[1].messages[1][1]
    assert [attempt.number for attempt in about.attempts] == [0, 2]


def test_findings_of_later_stages_are_not_repaired() -> None:
    about = state(brief=brief(), attempts=[Attempt(0, GAME)])
    context = ScriptedContext([""], lambda source: [finding("EC601"), finding("EC801"), finding("EC806")])
    assert run(Repair(), about, context).result == "passed"
    assert run(Instawin(), about, context).reason == "instawin: EC601 it is wrong"


@pytest.mark.parametrize(
    ("stage", "code", "reason"),
    [
        (Instawin(), "EC107", "judged again: EC107"),
        (Instawin(), "EC601", "instawin: EC601"),
        (Privileged(), "EC601", "judged again: EC601"),
        (Privileged(), "EC801", "too hard: EC801"),
        (Validated(), "EC801", "judged again: EC801"),
    ],
)
def test_an_attempt_under_other_settings_is_judged_again(stage: Stage, code: str, reason: str) -> None:
    about = state(brief=brief(), attempts=[Attempt(0, GAME)])
    outcome = run(stage, about, ScriptedContext([""], lambda source: [finding(code)]))
    assert outcome.reason.startswith(reason)
    assert about.attempts[0].report is not None


# Privileged


def privileged(
    *answers: str,
    difficulty: Verdict = Verdict.SKIP,
    found: str = "",
    fault: str = "EC806",
    left: tuple[str, ...] = (),
) -> tuple[StageOutcome, ConceptState, ScriptedContext]:
    """A policy that goes to the door wins 5 of 6 episodes and has the findings `left`; any other has the fault."""
    known = Attempt(0, GAME, report=report(GAME, *([finding(found)] if found else []), difficulty=difficulty))
    about = state(brief=brief(), attempts=[known])

    def plays(policy: str) -> PolicyEvaluation:
        if "state.door" in policy:
            return PolicyEvaluation(report(GAME, *map(finding, left)), 5, 6)
        return PolicyEvaluation(report(GAME, *([finding(fault, "it stands still")] if fault else [])), 0, 6)

    context = ScriptedContext([fenced(answer) for answer in answers], plays=plays)
    return run(Privileged(), about, context), about, context


def test_a_policy_that_wins() -> None:
    outcome, about, context = privileged(POLICY)
    assert (outcome.result, outcome.facts["wins"], len(context.requests)) == ("passed", 5, 1)
    assert about.policies[0].fault == ""


@pytest.mark.parametrize("fault", ["EC804", "EC805", "EC806", ""])
def test_a_policy_is_rewritten_with_the_complaint(fault: str) -> None:
    outcome, about, context = privileged(IDLE, POLICY, fault=fault)
    assert outcome.facts["policy"] == 1
    assert ("it stands still" if fault else "It wins none of 6 episodes") in context.requests[1].messages[1][1]
    assert IDLE.strip() in context.requests[1].messages[1][1]
    assert about.policies[0].fault


def test_lines_that_a_winning_policy_does_not_reach_are_an_error() -> None:
    outcome, _, context = privileged(POLICY, left=("EC809",))
    assert (outcome.result, len(context.requests)) == ("rejected", 1)
    assert outcome.reason == "never reached: EC809 it is wrong"


@pytest.mark.parametrize("found", ["EC808", "EC809"])
def test_a_policy_may_show_the_opposite_of_what_was_never_seen(found: str) -> None:
    assert privileged(POLICY, found=found)[0].result == "passed"


def test_lines_that_no_policy_reaches_are_an_error() -> None:
    outcome, about, _ = privileged(IDLE, difficulty=Verdict.PASS, found="EC809")
    assert outcome.reason == "never reached: EC809 it is wrong"
    assert len(about.policies) == 4


def test_a_game_that_nothing_wins_is_too_hard() -> None:
    outcome, about, _ = privileged(IDLE)
    assert outcome.result == "rejected"
    assert outcome.reason.startswith("too hard: no policy of 4 wins, nor does the search (not all states")
    assert len(about.policies) == 4


def test_a_win_of_the_search_alone_is_a_disagreement() -> None:
    outcome, _, _ = privileged(IDLE, difficulty=Verdict.PASS)
    assert outcome == StageOutcome("passed", facts={"policy": None, "search": True, "disagreement": True})


def test_a_completion_without_a_policy_fails() -> None:
    outcome, about, context = privileged("Hold left.\n", POLICY)
    assert outcome.facts["policy"] == 1
    assert "An answer before had no policy in it" in context.requests[1].messages[1][1]
    assert about.policies[0].source == ""


@pytest.mark.parametrize("answer", ["Hold left.\n", IDLE])
def test_policy_requests_are_distinct(answer: str) -> None:
    _, _, context = privileged(answer)
    assert len(context.requests) == 4
    assert len({(question.messages, question.sample) for question in context.requests}) == 4
    assert context.requests[0].sample == 0


@pytest.mark.parametrize(("code", "words"), [("EC801", "too hard: EC801"), ("EC802", "too easy: EC802")])
def test_a_finding_of_the_search_is_final(code: str, words: str) -> None:
    outcome, _, context = privileged(POLICY, found=code)
    assert outcome.reason.startswith(words)
    assert not context.requests


def test_no_policy_is_written_for_a_file_that_does_not_load() -> None:
    about = state(
        brief=brief(), attempts=[Attempt(0, GAME, report=report(GAME, finding("EC001", "it does not parse")))]
    )
    context = ScriptedContext([fenced(POLICY)])
    assert run(Privileged(), about, context).reason == "no game: EC001 it does not parse"
    assert not context.requests


def test_the_best_attempt_is_published() -> None:
    attempts = [Attempt(0, BAD), Attempt(1, GAME), Attempt(2, GUTTED, degenerate="size: 3 are left")]
    context = ScriptedContext([""])
    assert run(Validated(), state(attempts=attempts), context).facts == {"environment": "game.py", "attempt": 1}
