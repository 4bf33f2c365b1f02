"""Under the contract ``gymnasium`` good environments of every kind pass, and defects are still found."""

from __future__ import annotations

import textwrap

import pytest

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Severity, SubjectReport, Verdict
from evaluation.judge import failing

_TEMPLATE = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces

class Game(gym.Env):
    observation_space = {observation}
    action_space = {action}

    def observe(self):
        return {observe}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.last, self.total = 0, 0, 0.0
        self.card = int(self.np_random.integers(1, 11))
{reset}
        return self.observe(), {{}}

    def step(self, action):
        self.steps += 1
        reward, terminated, truncated, info = 0.0, False, False, {{}}
{step}
        return self.observe(), reward, terminated, truncated, info
"""
_FLOATS = "spaces.Box(-np.inf, np.inf, (3,), np.float64)"
_STATE = "np.array([self.steps, self.card, self.total])"


def source(
    step: str, observation: str = _FLOATS, observe: str = _STATE, action: str = "spaces.Discrete(3)", reset: str = ""
) -> str:
    inner = [textwrap.indent(textwrap.dedent(lines), " " * 8) for lines in (reset, step)]
    return _TEMPLATE.format(observation=observation, observe=observe, action=action, reset=inner[0], step=inner[1])


#: Draws a card or stays: over in a step or two, and often with the same result.
SHORT = source("""
    self.total += self.card if action else 0
    self.card = int(self.np_random.integers(1, 11))
    terminated = action == 0 or self.total > 9
    reward = float(np.sign(self.total - 7)) if terminated else 0.0
""")
#: A context without memory, one decision each, never ends.
BANDIT = source(
    """
    reward = float(action == self.card % 3) * 1e9
    self.card = int(self.np_random.integers(1, 11))
    """,
    observe="self.np_random.normal(size=3)",
)
#: A context that stays for an episode, and says which arm pays; twenty pulls.
CONTEXTUAL = source(
    "reward, truncated = float(action == self.card % 3), self.steps == 20", observe="np.array([0.0, self.card, 1.0])"
)
#: Its observation is of the reset, although the card changes.
OLD = source(
    """
    reward, truncated = float(action == self.card % 3), self.steps == 20
    self.card = int(self.np_random.integers(1, 11))
    """,
    observe="np.array([0.0, self.first, 1.0])",
    reset="self.first = self.card",
)
#: Random play stops at the gate of a ring in the end, and no step limit ends an episode before.
RING = source(
    """
    self.card = (self.card + int(action) - 1) % 12
    terminated = bool(self.card == 0 and action == 1)
    reward, info = float(terminated), {"is_success": terminated}
    """
)
#: One observation for good, and a price for the right arm; ten pulls.
ARMS = source("reward, truncated = float(action), self.steps == 10", "spaces.Discrete(1)", "0")
#: Only the goal ends it, always with the same reward; no seed matters; it goes on after its end.
GOAL = source(
    """
    self.total = max(self.total + (1 if action == 1 else -1), 0.0)
    terminated = self.total >= 4
    reward = float(terminated)
    """,
    observe="np.array([0.0, 0.0, self.total])",
)
#: Every return is negative, and there is nothing wrong with that.
COSTS = source("""
    self.total += action
    reward, terminated = -1e6, self.total > 30
""")
#: Rounding takes it past its bound; int32 casts safely; info has what JSON has not.
ROUGH = source(
    """
    self.total += 0.1 * action
    info = {"array": np.ones(3), "nan": float("nan"), "object": object, "set": {1, 2}}
    """,
    observation="spaces.Dict(angle=spaces.Box(-np.pi, np.pi, (1,), np.float32),"
    " at=spaces.Box(0, 1e6, (1,), np.float64), pair=spaces.Tuple((spaces.Discrete(99999), spaces.MultiBinary(2))))",
    observe='{"angle": np.array([np.float32(np.pi) * np.float32(1 + 1e-6)], np.float32),'
    ' "at": np.array([self.steps], np.int32), "pair": (self.card + int(self.total), np.array([1, 0], np.int8))}',
)
#: Spaces of changing length, as observation and as action.
GRAPHS = source(
    """
    assert isinstance(action, tuple) and all(isinstance(item, spaces.GraphInstance) for item in action)
    self.total += len(action)
    """,
    observation="spaces.Graph(spaces.Box(-1, 1, (2,)), spaces.Discrete(5))",
    observe="spaces.GraphInstance(np.full((3, 2), np.cos(self.total), np.float32), np.array([self.card % 5]),"
    " np.array([[0, 2]], np.int32))",
    action="spaces.Sequence(spaces.Graph(spaces.Box(0, 1, (1,)), None))",
)
CHOICES = source(
    """
    kind, value = action
    self.total += kind + (len(value["words"]) if kind == 1 else float(value[0, 0]))
    """,
    observation="spaces.Sequence(spaces.OneOf((spaces.Discrete(11), spaces.Text(4))))",
    observe='((0, self.card), (1, "ab"), (0, int(abs(self.total)) % 11))',
    action="spaces.OneOf((spaces.Sequence(spaces.Box(-np.inf, 5, (2,)), stack=True),"
    " spaces.Dict(words=spaces.Text(9))))",
)
#: Observations of the type that the action has: int64, int32 or an int.
PASSED_ON = source(
    "self.last = min(self.last + action, 19)",
    "spaces.Dict(at=spaces.Discrete(20), two=spaces.Box(0, 99, (2,), np.int64))",
    "{'at': self.last, 'two': np.array([self.last, self.card])}",
)
#: Lists and numbers where arrays are meant, which `contains` reads as such.
LISTS = source(
    "self.total += action",
    "spaces.Dict(bits=spaces.MultiBinary(2), floats=spaces.MultiBinary(2), many=spaces.MultiDiscrete([99999, 11]),"
    " flag=spaces.Discrete(2), at=spaces.Box(0, np.inf, (2,)), one=spaces.Box(-9, 1e6, ()))",
    "{'bits': [1, self.steps % 2], 'floats': np.array([1.0, 0.0]), 'many': (int(self.total), self.card),"
    " 'flag': self.card > 5, 'at': [float(self.total), 1], 'one': float(self.total)}",
)
#: A context is shown, something is chosen, and that is all.
CONTEXT = source("terminated, reward = True, float(action == self.card % 3)", observe="np.array([0.0, self.card, 1.0])")
#: Five rounds, then time is up.
ROUNDS = source("""
    reward, truncated = float((action + self.card) % 3 - 1), self.steps == 5
    self.card = int(self.np_random.integers(1, 11))
""")
#: Waiting for cargo costs a step of the day.
FERRY = source(
    """
    self.total = min(self.total + action, 4) if action < 2 else 0
    reward, truncated = float(action == 2), self.steps >= 90
""",
    observe="np.array([0.0, self.card, self.total])",
)
PAUSED = FERRY.replace("        self.steps += 1\n", "").replace(
    "self.total = min",
    "if action == 0 and self.total == 0:\n"
    "            return self.observe(), 0.0, False, False, {}\n        self.steps += 1\n        self.total = min",
)
#: A wrong step is a fall, and nobody has come to the end of the rope.
TIGHTROPE = source("""
    fell = action != self.card % 3
    self.total += not fell
    self.card = int(self.np_random.integers(1, 11))
    won = self.total == 20
    reward, terminated, info = float(not fell), fell or won, {"is_success": won}
""")
#: A little for each step, and for the one long sequence of actions that wins nobody knows what.
BONUS = source("""
    self.total = self.total + 1 if action == (self.card + int(self.total)) % 3 else 0.0
    won = self.total >= 25
    reward, terminated, truncated, info = 1.0 + won, won, self.steps >= 60 and not won, {"is_success": won}
""")
#: Equal dictionaries whose keys come in an order that is nobody's.
UNORDERED = source("self.total += action\ninfo = {'found': dict.fromkeys({'ant', 'bee', 'cat', 'dog'}, self.steps)}")
#: A kind of space that only the package knows.
OWN = source("self.total += action", "Mood()", "f'mood {self.total}'").replace(
    "class Game",
    "class Mood(spaces.Space):\n    def contains(self, x):\n        return isinstance(x, str)\n\nclass Game",
)
#: Observations that nobody else can look into, alone and in a space that everybody knows.
OBJECTS = OWN.replace("isinstance(x, str)", "isinstance(x, set)").replace("f'mood {self.total}'", "{self.total}")
DATES = OBJECTS.replace("isinstance(x, set)", "isinstance(x, np.datetime64)").replace(
    "{self.total}", "np.datetime64(int(self.total), 's')"
)
CROWDS = OBJECTS.replace("isinstance(x, set)", "len(x) == 5000").replace(
    "{self.total}", "{n: self.total for n in range(5000)}"
)
RECORDS = OWN.replace("isinstance(x, str)", "isinstance(x, np.ndarray)").replace(
    "f'mood {self.total}'", "np.array([(1, self.total)], 'i4, f8')"
)
MIXED = OBJECTS.replace("= Mood()", "= spaces.Dict(at=spaces.Discrete(99999), mood=Mood())").replace(
    "{self.total}", "{'at': 1, 'mood': {self.total}}"
)
#: Actions of more numbers than a message shows.
WIDE = source("self.total += float(action['push'].sum())", action="spaces.Dict(push=spaces.Box(-1, 1, (10, 10)))")
WRITES = WIDE.replace("self.total +=", "action['push'][3, 3] = 0; self.total +=")
GOOD = {
    "wide": WIDE,
    "short": SHORT,
    "bandit": BANDIT,
    "contextual bandit": CONTEXTUAL,
    "ring": RING,
    "arms": ARMS,
    "goal": GOAL,
    "costs": COSTS,
    "rough": ROUGH,
    "graphs": GRAPHS,
    "choices": CHOICES,
    "own": OWN,
    "lists": LISTS,
    "action passed on": PASSED_ON,
    "context": CONTEXT,
    "rounds": ROUNDS,
    "tightrope": TIGHTROPE,
    "bonus": BONUS,
    "ferry": FERRY,
    "unordered": UNORDERED,
    "objects": OBJECTS,
    "records": RECORDS,
    "dates": DATES,
    "crowds": CROWDS,
    "mixed": MIXED,
}
#: Those that pay nothing, because they are about spaces.
UNPAID = set(GOOD) - {
    "short",
    "bandit",
    "contextual bandit",
    "ring",
    "arms",
    "goal",
    "costs",
    "context",
    "rounds",
    "bonus",
    "tightrope",
    "ferry",
}
BAD = {
    "EC109 past the bound": ("EC109", ROUGH.replace("1e-6", "1e-3")),
    "EC104 needs a seed": ("EC104", source("self.total += action", reset="self.total = float(seed % 2)")),
    "EC104 needs a library": ("EC104", source("self.total += action", reset="raise gym.error.DependencyNotInstalled")),
    "EC104 needs options": ("EC104", source("self.total += action", reset="self.total = float('x' in options)")),
    "EC108 ragged list": ("EC108", LISTS.replace("[float(self.total), 1]", "[float(self.total)]")),
    "EC109 half a bit": ("EC109", LISTS.replace("[1.0, 0.0]", "[1.0, 0.5]")),
    "EC203 unordered list": ("EC203", UNORDERED.replace("dict.fromkeys({", "list({").replace("}, self.steps)", "})")),
    "EC108 no safe cast": ("EC108", ROUGH.replace("np.float32(1 + 1e-6)], np.float32)", "np.float32(1)], np.float64)")),
    "EC109 no such node": ("EC109", GRAPHS.replace("[[0, 2]]", "[[0, 3]]")),
    "EC108 edges without links": ("EC108", GRAPHS.replace("np.array([[0, 2]], np.int32)", "None")),
    "EC109 no such choice": ("EC109", CHOICES.replace("(0, self.card)", "(2, self.card)")),
    "EC108 array of objects": ("EC108", COSTS.replace(_STATE, _STATE + ".astype(object)")),
    "EC108 list for a sequence": ("EC108", CHOICES.replace("return ((0", "return [(0").replace("% 11))", "% 11)]")),
    "EC111 writes into the action": ("EC111", WRITES),
    "EC201 unseeded": ("EC201", SHORT.replace("self.np_random.integers", "np.random.default_rng().integers")),
    "EC204 global state": ("EC204", SHORT.replace("self.np_random.integers", "np.random.randint")),
    "EC206 carried over": ("EC206", COSTS.replace("self.total = 0, 0, 0.0", "_ = 0, 0, 0.0").replace(
        "observation_space =", "total = 0.0\n    observation_space =")),
    "EC301 NaN": ("EC301", COSTS.replace("-1e6", "-1e6 if self.total < 9 else np.float64('nan')")),
    "EC302 array": ("EC302", COSTS.replace("-1e6", "np.ones(1)")),
    "EC401 never drawn again": ("EC401", COSTS.replace(_STATE, "np.array([0.0, self.card, 1.0])")),
    "EC401 constant": ("EC401", COSTS.replace(_STATE, "np.zeros(3)")),
    "EC401 constant graph": ("EC401", COSTS.replace(_FLOATS, "spaces.Graph(spaces.Box(-1, 1, (2,)), None)").replace(
        _STATE, "spaces.GraphInstance(np.zeros((3, 2), np.float32), None, None)")),
    "EC403 unresponsive": ("EC403", COSTS.replace(_STATE, "np.array([self.steps, self.card, 0.0])").replace(
        "self.total > 30", "self.steps > 30")),
    "EC501 an action that stops the clock": ("EC501", PAUSED),
    "EC503 over at once": ("EC503", COSTS.replace("self.total > 30", "self.steps == 2")),
    "EC503 over at once, and lost": ("EC503", TIGHTROPE.replace("fell or won", "self.steps == 2").replace(
        "float(not fell)", "-1.0").replace('"is_success": won', '"is_success": won, "at": self.total')),
    "EC504 flag": ("EC504", COSTS.replace("self.total > 30", "int(self.total > 30)")),
    "EC507 a win that is truncated": ("EC507", BONUS.replace(">= 25", ">= 5").replace(
        "1.0 + won, won, self.steps >= 60 and not won", "float(won), False, won or self.steps >= 60")),
    "EC601 random wins": ("EC601 EC802", COSTS.replace("{}\n", '{"is_success": True}\n')),
    "EC602 paid": ("EC602", COSTS.replace("-1e6, self.total > 30", "1.0, self.steps == 30")),
}  # fmt: skip


#: A context that stays for an episode and says how often each arm pays.
CHANCES = source(
    "reward, truncated = float(self.np_random.random() < self.chances[action]), self.steps == 20",
    observe="self.chances.copy()",
    reset="self.chances = self.np_random.random(3)",
)
UNKNOWN_ACTIONS = OWN.replace("action_space = spaces.Discrete(3)", "action_space = Mood()")


@pytest.fixture(scope="module")
def reports() -> dict[str, SubjectReport]:
    """The report on each source."""
    texts = [*GOOD.values(), *(text for _, text in BAD.values()), UNKNOWN_ACTIONS, CHANCES, OLD]
    targets = [Target("game.py", text.encode()) for text in texts]
    *_, last = validate(Plan(targets, GYMNASIUM, driver_named("process"), default_checks(), BUDGETS["quick"]))
    assert isinstance(last, Finished)
    return dict(zip(texts, last.report.reports, strict=True))


@pytest.mark.parametrize("name", GOOD)
def test_good_environments_have_no_finding_but_that_some_pay_nothing(
    name: str, reports: dict[str, SubjectReport]
) -> None:
    report = reports[GOOD[name]]
    found = [f"{found.code} {found.message}" for check in report.checks for found in check.findings]
    allowed = ["EC306"] * (name in UNPAID) + ["EC601"] * (name == "ring")
    assert [words[:5] for words in found] == allowed, found
    assert report.verdict is Verdict.PASS
    assert report.steps > 200


@pytest.mark.parametrize("name", BAD)
def test_defects_are_found(name: str, reports: dict[str, SubjectReport]) -> None:
    code, text = BAD[name]
    assert failing(reports[text]) == set(code.split())


@pytest.mark.parametrize("text", [CHANCES, OLD], ids=["chances", "old context"])
def test_a_context_that_stays_while_rewards_vary_is_a_warning(text: str, reports: dict[str, SubjectReport]) -> None:
    report = reports[text]
    (found,) = (found for check in report.checks for found in check.findings if found.code == "EC401")
    assert found.severity is Severity.WARNING
    assert "right only for a contextual bandit" in found.message
    assert report.verdict is Verdict.PASS


def test_actions_of_an_unknown_space_are_not_drawn(reports: dict[str, SubjectReport]) -> None:
    report = reports[UNKNOWN_ACTIONS]
    reasons = {check.check: check.reason for check in report.checks}
    assert "no actions can be drawn" in reasons["api"]
    assert report.verdict is Verdict.PASS
