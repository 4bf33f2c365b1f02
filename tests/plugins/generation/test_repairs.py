"""The stages that judge and repair, with a model and judges that say what the test wants."""

from __future__ import annotations

import pytest
from envcraft_llm.stages import Instawin, Privileged, Repair, Validated

from envcraft.stages import Attempt, Case, Outcome, Played, Stage
from envcraft.verdict import Finding, Verdict

from .content import GAME, GUTTED, IDLE, POLICY, brief
from .scripted import ScriptedBench, case, fenced, finding, report, run

# Repair


def judged(source: str) -> list[Finding]:
    return [finding("EC107", "step() raises IndexError", 40, traceback="line 40")] if "BAD" in source else []


BAD = GAME.replace("LIMIT = 200", "LIMIT = 200  # BAD")


def repaired(*answers: str, first: str = BAD) -> tuple[Outcome, Case, ScriptedBench]:
    about = case(brief=brief(), attempts=[Attempt(0, first)])
    bench = ScriptedBench([fenced(answer) for answer in answers], judged)
    return run(Repair(), about, bench), about, bench


def test_what_has_no_finding_is_not_repaired() -> None:
    outcome, _, bench = repaired(GAME, first=GAME)
    assert outcome == Outcome("passed", facts={"attempt": 0})
    assert not bench.asked


def test_a_repair_is_told_all_that_it_needs() -> None:
    outcome, about, bench = repaired(GAME)
    assert outcome.facts["attempt"] == 1
    said = bench.asked[0].messages[1][1]
    for words in (
        brief().strip(),
        BAD.strip(),
        "EC107 (step-raises)",
        "step() raises IndexError",
        "Mend the line that is named",
        "  40>",
        "reset(seed=3)",
        "[[1, 0, 0], [4, 1, 0]]",
        "What was raised:\n\n```\nline 40",
        "repair 1 of 3",
    ):
        assert words in said
    assert "-LIMIT = 200  # BAD" in about.attempts[1].diff
    assert "+LIMIT = 200" in about.attempts[1].diff


def test_three_repairs_and_no_more() -> None:
    outcome, about, bench = repaired(BAD.replace("DOOR_PAY = 10.0", "DOOR_PAY = 9.0"))
    assert outcome.result == "rejected"
    assert outcome.reason.startswith("unfixable: EC107 step() raises IndexError")
    assert (len(bench.asked), len(about.attempts)) == (3, 4)


def test_a_repair_that_guts_the_game_is_refused_and_told_so() -> None:
    outcome, about, bench = repaired(GUTTED, GAME)
    assert outcome == Outcome("passed", facts={"attempt": 2})
    assert about.attempts[1].gutted
    assert "The repair before was refused" in bench.asked[1].messages[1][1]
    # It goes on from what stood before.
    assert "# BAD" in bench.asked[1].messages[1][1]


def test_gutting_to_the_end_is_the_reason() -> None:
    outcome, about, _ = repaired(GUTTED)
    assert outcome.reason.startswith("gutted: attempt 1 passes by being less")
    assert about.best is about.attempts[0]


def test_an_answer_without_a_file_counts_as_a_repair() -> None:
    outcome, about, bench = repaired("", GAME)
    assert outcome == Outcome("passed", facts={"attempt": 2})
    assert "The answer before had no complete file in it." in bench.asked[1].messages[1][1]
    assert [attempt.number for attempt in about.attempts] == [0, 2]


def test_what_later_stages_judge_is_not_repaired() -> None:
    about = case(brief=brief(), attempts=[Attempt(0, GAME)])
    bench = ScriptedBench([""], lambda source: [finding("EC601"), finding("EC801"), finding("EC806")])
    assert run(Repair(), about, bench).result == "passed"
    assert run(Instawin(), about, bench).reason == "instawin: EC601 it is wrong"


@pytest.mark.parametrize(
    ("stage", "code", "reason"),
    [
        (Instawin(), "EC107", "judged anew: EC107"),
        (Instawin(), "EC601", "instawin: EC601"),
        (Privileged(), "EC601", "judged anew: EC601"),
        (Privileged(), "EC801", "too hard: EC801"),
        (Validated(), "EC801", "judged anew: EC801"),
    ],
)
def test_what_this_run_has_not_judged_is_judged_before_it_counts(stage: Stage, code: str, reason: str) -> None:
    about = case(brief=brief(), attempts=[Attempt(0, GAME)])
    outcome = run(stage, about, ScriptedBench([""], lambda source: [finding(code)]))
    assert outcome.reason.startswith(reason)
    assert about.attempts[0].report is not None


# Privileged


def privileged(
    *answers: str, difficulty: Verdict = Verdict.SKIP, found: str = "", fault: str = "EC806"
) -> tuple[Outcome, Case, ScriptedBench]:
    """A policy that goes to the door wins 5 of 6; any other has the fault."""
    known = Attempt(0, GAME, report=report(GAME, *([finding(found)] if found else []), difficulty=difficulty))
    about = case(brief=brief(), attempts=[known])

    def plays(policy: str) -> Played:
        if "state.door" in policy:
            return Played(report(GAME), 5, 6)
        return Played(report(GAME, *([finding(fault, "it stands still")] if fault else [])), 0, 6)

    bench = ScriptedBench([fenced(answer) for answer in answers], plays=plays)
    return run(Privileged(), about, bench), about, bench


def test_a_policy_that_wins() -> None:
    outcome, about, bench = privileged(POLICY)
    assert (outcome.result, outcome.facts["wins"], len(bench.asked)) == ("passed", 5, 1)
    assert about.policies[0].fault == ""


@pytest.mark.parametrize("fault", ["EC804", "EC805", "EC806", ""])
def test_a_policy_is_written_again_with_what_is_wrong(fault: str) -> None:
    outcome, about, bench = privileged(IDLE, POLICY, fault=fault)
    assert outcome.facts["policy"] == 1
    assert ("it stands still" if fault else "It wins none of 6 episodes") in bench.asked[1].messages[1][1]
    assert IDLE.strip() in bench.asked[1].messages[1][1]
    assert about.policies[0].fault


def test_where_nobody_wins_it_is_too_hard() -> None:
    outcome, about, _ = privileged(IDLE)
    assert outcome.result == "rejected"
    assert outcome.reason.startswith("too hard: no policy of 4 wins, nor does the search (not all states")
    assert len(about.policies) == 4


def test_where_only_the_search_wins_it_is_kept_with_the_disagreement() -> None:
    outcome, _, _ = privileged(IDLE, difficulty=Verdict.PASS)
    assert outcome == Outcome("passed", facts={"policy": None, "search": True, "disagreement": True})


def test_an_answer_without_a_policy_is_a_policy_that_fails() -> None:
    outcome, about, bench = privileged("Hold left.\n", POLICY)
    assert outcome.facts["policy"] == 1
    assert "An answer before had no policy in it" in bench.asked[1].messages[1][1]
    assert about.policies[0].source == ""


@pytest.mark.parametrize("answer", ["Hold left.\n", IDLE])
def test_no_two_questions_for_a_policy_are_the_same(answer: str) -> None:
    _, _, bench = privileged(answer)
    assert len(bench.asked) == 4
    assert len({(question.messages, question.sample) for question in bench.asked}) == 4
    assert bench.asked[0].sample == 0


@pytest.mark.parametrize(("code", "words"), [("EC801", "too hard: EC801"), ("EC802", "too easy: EC802")])
def test_what_the_search_has_settled_is_not_played(code: str, words: str) -> None:
    outcome, _, bench = privileged(POLICY, found=code)
    assert outcome.reason.startswith(words)
    assert not bench.asked


def test_no_policy_is_written_for_what_cannot_be_loaded() -> None:
    about = case(brief=brief(), attempts=[Attempt(0, GAME, report=report(GAME, finding("EC001", "it does not parse")))])
    bench = ScriptedBench([fenced(POLICY)])
    assert run(Privileged(), about, bench).reason == "no game: EC001 it does not parse"
    assert not bench.asked


def test_the_last_attempt_that_stands_is_published() -> None:
    attempts = [Attempt(0, BAD), Attempt(1, GAME), Attempt(2, GUTTED, gutted="size: 3 are left")]
    bench = ScriptedBench([""])
    assert run(Validated(), case(attempts=attempts), bench).facts == {"environment": "game.py", "attempt": 1}
