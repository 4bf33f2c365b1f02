"""Environments under wrappers: what a wrapper file says, and whom a finding names."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.envcraft.conftest import ENVIRONMENT, Invoke


def test_a_wrapper_of_the_environment_s_own_file(invoke: Invoke, good: Path) -> None:
    good.write_text(
        f"{ENVIRONMENT}\n\nclass Half(gym.RewardWrapper):\n    def reward(self, reward):\n        return reward / 2\n"
    )
    options = ("--class", "Walk", "--sandbox", "process", "--contract", "gymnasium", "--checks", "api")
    result = invoke("validate", good, *options, "--wrap", "walk:Half")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("line", "kind"),
    [("def make():\n    return Walk()", "a function"), ("import os as make", "a module"), ("make = [1]", "a value")],
)
def test_a_name_that_is_no_class_is_wrong_use(
    line: str, kind: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    good.write_text(f"{ENVIRONMENT}\n\n{line}\n")
    for words in (["walk:make"], [good, "--class", "make"]):
        result = invoke("validate", *words, "--sandbox", "process", "--contract", "gymnasium")
        assert result.exit_code == 2, result.output
        assert f"make of {'walk.py' if len(words) == 1 else good} is {kind}; name a class" in result.stderr


def test_a_file_of_a_wrapper_says_how_to_judge_it(invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(good.parent)
    Path("wrappers").mkdir()
    Path("wrappers/__init__.py").write_text("")
    Path("wrappers/slow.py").write_text("from gymnasium import Wrapper\n\nclass Slow(Wrapper):\n    pass\n")
    options = ["--sandbox", "process", "--format", "concise"]
    result = invoke("validate", "wrappers/slow.py", *options)
    assert "wrappers/slow.py:3: EC005" in result.stdout
    told = re.search(r"Slow is a wrapper; to judge it, validate an environment with (.*)", result.stdout)
    assert told is not None, result.stdout
    judged = invoke("validate", good, *told[1].split(), *options, "--checks", "api", "--budget", "quick")
    assert judged.exit_code == 0, judged.output


_SHAPED = """from gymnasium import RewardWrapper
from bonus import BONUS

class Shaped(RewardWrapper):
    def reward(self, reward):
        return reward + BONUS
"""


@pytest.mark.parametrize("target", ["CartPole-v1", "gymnasium.envs.classic_control:CartPoleEnv", "other/walk.py"])
def test_a_wrapper_of_the_working_directory(
    target: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("own").mkdir()
    Path("other").mkdir()
    Path("other/walk.py").write_text(good.read_text())
    Path("own/shaped.py").write_text(_SHAPED)
    Path("own/plain.py").write_text("from gymnasium import RewardWrapper\nclass Plain(RewardWrapper):\n    pass\n")
    Path("bonus.py").write_text("BONUS = 0.0\n")
    options = ["--sandbox", "process", "--contract", "gymnasium", "--budget", "quick"]
    told = invoke("validate", "own/plain.py", *options, "--format", "concise").stdout
    assert "validate an environment with --wrap own.plain:Plain" in told
    options += ["--checks", "reward", "--wrap", "own.shaped:Shaped", "--format", "json", "--output", "report.json"]
    assert invoke("validate", target, *options).exit_code == 0
    Path("bonus.py").write_text("BONUS = float('nan')\n")
    assert invoke("validate", target, *options).exit_code == 1
    again = invoke("replay", "report.json", "--sandbox", "process")
    assert again.exit_code == 0, again.output


def test_wrong_use_names_the_target_and_no_installed_file(
    invoke: Invoke, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ("--sandbox", "process", "--contract", "gymnasium", "--format", "concise", "--wrap", "nowhere:Shaped")
    result = invoke("validate", "CartPole-v1", *options)
    assert result.exit_code == 2
    assert result.stdout.startswith("CartPole-v1: error: "), result.stdout


def test_a_wrapper_of_the_project_under_a_contract_for_single_files(
    invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("slow.py").write_text("from gymnasium import Wrapper\n\nclass Slow(Wrapper):\n    pass\n")
    result = invoke("validate", good, "--wrap", "slow:Slow", "--sandbox", "process", "--format", "concise")
    assert result.exit_code == 2
    assert "the contract arcade is for single files; name --contract gymnasium" in result.stdout
    assert "not installed" not in result.stdout


def test_a_wrapper_that_a_target_names_says_how_to_judge_it(
    invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("slow.py").write_text("from gymnasium import Wrapper\n\nclass Slow(Wrapper):\n    pass\n")
    Path("named.py").write_text("from slow import Slow\n")
    options = ["--sandbox", "process", "--contract", "gymnasium", "--format", "concise"]
    words = "is a wrapper; to judge it, validate an environment with --wrap"
    assert f"slow.py:3: EC005 Slow {words} slow:Slow" in invoke("validate", "slow:Slow", *options).stdout
    assert f"EC005 Slow {words} named:Slow" in invoke("validate", "named.py", "--class", "Slow", *options).stdout
    named = invoke("validate", "gymnasium.wrappers:TimeLimit", *options)
    assert named.exit_code == 2
    assert f"TimeLimit {words} gymnasium.wrappers:TimeLimit" in named.stdout


def test_a_class_that_is_no_environment_is_wrong_use(
    invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    bare = "class Simulator:\n    def __init__(self, dt):\n        self.dt = dt\n"
    Path("plain.py").write_text(bare)
    Path("derived.py").write_text("from plain import Simulator\n\nclass Fine(Simulator):\n    pass\n")
    Path("alike.py").write_text(f"{bare}    def reset(self): ...\n    def step(self, action): ...\n")
    options = ["--sandbox", "process", "--contract", "gymnasium", "--format", "concise"]
    for target, words in [
        (["plain.py", "--class", "Simulator"], "is a class without a base"),
        (["plain:Simulator"], "does not derive from gymnasium.Env, and has no reset() and no step()"),
        (["derived.py", "--class", "Fine"], "does not derive from gymnasium.Env, and has no reset() and no step()"),
        (["gymnasium.spaces:Box"], "which has no reset() and no step()"),
    ]:
        result = invoke("validate", *target, *options)
        assert (result.exit_code, words in result.output) == (2, True), result.output
    result = invoke("validate", "alike.py", "--class", "Simulator", *options)
    assert result.exit_code == 1
    assert "EC005 Simulator does not derive from gymnasium.Env" in result.stdout


_WRAPPERS = """import random
import gymnasium as gym


class Halved(gym.ObservationWrapper):
    def observation(self, observation):
        return observation / 2


class Nothing(gym.RewardWrapper):
    def reward(self, reward):
        return float("nan")


class Refuses(gym.Wrapper):
    def __init__(self, env):
        super().__init__(env)
        raise ValueError("I do not want this")


class Quiet(gym.Wrapper):
    pass


class Draws(gym.RewardWrapper):
    def reward(self, reward):
        return random.random()


class Grows(gym.Wrapper):
    def reset(self, **options):
        self.steps = 0
        return self.env.reset(**options)

    def step(self, action):
        self.steps += 1
        observation, reward, *rest = self.env.step(action)
        return observation, float(self.steps), *rest


class More(gym.Wrapper):
    action_space = gym.spaces.Discrete(9)

    def step(self, action):
        return self.env.step(action if action < 5 else [[]])
"""
_LOCATED = ("concise", "github", "sarif")
_WITHOUT = "; without the wrapper wrappers:{} it does not occur"


@pytest.mark.parametrize(
    ("wrappers", "code", "words"),
    [
        (["Halved"], "EC108", _WITHOUT.format("Halved")),
        (["Nothing"], "EC301", _WITHOUT.format("Nothing")),
        (["Refuses"], "EC008", f"wrappers.py line 18: I do not want this{_WITHOUT.format('Refuses')}"),
        (["Draws"], "EC204", _WITHOUT.format("Draws")),
        (
            ["Quiet", "Halved"],
            "EC108",
            "; without the wrappers wrappers:Quiet and wrappers:Halved it does not occur",
        ),
    ],
)
def test_a_finding_names_the_wrapper_that_causes_it_and_no_line_of_the_environment(
    wrappers: list[str], code: str, words: str, invoke: Invoke, good: Path
) -> None:
    found = _wrapped(invoke, good, wrappers)
    assert found[code]["message"].endswith(words)
    assert found[code]["line"] is None


def test_a_crash_of_a_wrapper_is_located_in_its_file(
    invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("layers").mkdir()
    Path("layers/own.py").write_text(_WRAPPERS)
    line = _WRAPPERS.splitlines().index('        raise ValueError("I do not want this")') + 1
    options = ("--sandbox", "process", "--contract", "gymnasium", "--checks", "api", "--wrap", "layers.own:Refuses")
    for target in ("walk.py", "CartPole-v1"):
        shown = {name: invoke("validate", target, *options, "--format", name).stdout for name in _LOCATED}
        assert f"layers/own.py:{line}: EC008" in shown["concise"]
        assert f"file=layers/own.py,line={line}," in shown["github"]
        [result] = json.loads(shown["sarif"])["runs"][0]["results"]
        [place] = [each["physicalLocation"] for each in result["locations"]]
        assert (place["artifactLocation"]["uri"], place["region"]) == ("layers/own.py", {"startLine": line})
        assert "relatedLocations" not in result


def test_a_finding_of_a_wrapper_says_nothing_about_a_base_of_the_environment(
    invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("base.py").write_text(good.read_text())
    good.write_text("import base\n\n\nclass Stroll(base.Walk):\n    pass\n")
    message = _wrapped(invoke, good, ["Halved"])["EC108"]["message"]
    assert message.endswith(_WITHOUT.format("Halved"))
    assert "inherited" not in message


@pytest.mark.parametrize(
    ("source", "code"),
    [
        (b"\xff", "EC001"),
        (f"import nunpy\n{ENVIRONMENT}".encode(), "EC002"),
        (b"raise ValueError\n", "EC003"),
        (b"import gymnasium as gym\nclass Room(gym.Env):\n    pass\n", "EC005"),
    ],
)
def test_a_file_that_cannot_be_constructed_has_the_same_finding_under_wrappers(
    source: bytes, code: str, invoke: Invoke, good: Path
) -> None:
    good.write_bytes(source)
    found = [_wrapped(invoke, good, wrappers)[code] for wrappers in ([], ["Quiet"])]
    assert found[0] == found[1]


def test_a_finding_of_the_environment_alone_names_no_wrapper(invoke: Invoke, good: Path) -> None:
    good.write_text(ENVIRONMENT.replace("return self.render(), {}", "return self.render() / 2, {}"))
    found = _wrapped(invoke, good, ["Quiet"])
    assert "wrapper" not in found["EC108"]["message"]
    line = good.read_text().splitlines()[found["EC108"]["line"] - 1].strip()
    assert line == "return self.render() / 2, {}"


def test_a_draw_of_the_environment_alone_names_its_line_and_no_wrapper(invoke: Invoke, good: Path) -> None:
    source = ENVIRONMENT.replace("import gymnasium", "import random\n\nimport gymnasium", 1)
    place = source.index("        super().reset(seed=seed)\n")
    drawn = source[:place] + source[place:].replace(
        "seed=seed)\n", "seed=seed)\n        self.luck = random.random()\n", 1
    )
    good.write_text(drawn.replace("return self.render(), {}", 'return self.render(), {"luck": self.luck}'))
    found = _wrapped(invoke, good, ["Quiet"])
    assert "wrapper" not in found["EC204"]["message"]
    assert "luck" in good.read_text().splitlines()[found["EC204"]["line"] - 1]


def test_a_loop_that_a_wrapper_pays_names_no_line_that_the_environment_pays_at(invoke: Invoke, good: Path) -> None:
    good.write_text(ENVIRONMENT)
    found = _wrapped(invoke, good, ["Grows"])
    assert found["EC304"]["message"].endswith("; judged in the wrapper wrappers:Grows")
    assert found["EC304"]["line"] is None


def test_a_finding_of_actions_that_only_a_wrapper_allows_names_it(invoke: Invoke, good: Path) -> None:
    found = _wrapped(invoke, good, ["More"])
    assert found["EC107"]["message"].endswith("; judged in the wrapper wrappers:More")
    assert "action[0]" in good.read_text().splitlines()[found["EC107"]["line"] - 1]


def _wrapped(invoke: Invoke, good: Path, wrappers: list[str]) -> dict[str, dict[str, Any]]:
    """The findings under wrappers by code."""
    good.with_name("wrappers.py").write_text(_WRAPPERS)
    wrap = [word for name in wrappers for word in ("--wrap", f"wrappers:{name}")]
    options = ("--sandbox", "process", "--contract", "gymnasium", "--budget", "quick", "--format", "json")
    result = invoke("validate", good, *wrap, *options, "--checks", "api,determinism,reward")
    [report] = json.loads(result.stdout)["reports"]
    return {finding["code"]: finding for check in report["checks"] for finding in check["findings"]}
