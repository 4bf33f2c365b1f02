"""Extraction of files from completions."""

from __future__ import annotations

import time

import pytest
from envcraft_llm import extraction

ENV = """\
import gymnasium as gym


class GameEnv(gym.Env):
    def reset(self, *, seed=None, options=None):
        return 0, {}

    def step(self, action):
        return 0, 0.0, False, False, {}
"""
OTHER = ENV.replace("GameEnv", "CaveEnv")
PLAIN = ENV.replace("(gym.Env)", "")
HELPER = "class Bat:\n    def step(self):\n        return 1\n"
BROKEN = ENV.replace("return 0, {}", "return (0, {}")
USAGE = "env = GameEnv()\nenv.reset(seed=0)\n"
MAP = ENV.replace("class Game", 'LEVEL = """\n#   \n# # \n"""\n\n\nclass Game')
HARMONY = (
    "<|channel|>analysis<|message|>Plan:\n```python\nx = 1\n```<|end|><|start|>assistant<|channel|>final<|message|>"
)


def fenced(code: str, language: str = "python", mark: str = "```") -> str:
    return f"{mark}{language}\n{code}{mark}\n"


CASES = {
    "one fence": (fenced(ENV), ENV),
    "prose before": (f"Sure! Here it is.\n\n{fenced(ENV)}", ENV),
    "prose after": (f"{fenced(ENV)}\nIt is won by `reset`.", ENV),
    "py": (fenced(ENV, "py"), ENV),
    "Python with a capital": (fenced(ENV, "Python"), ENV),
    "no language": (fenced(ENV, ""), ENV),
    "words after the language": (fenced(ENV, 'python title="game.py"'), ENV),
    "tildes": (fenced(ENV, "python", "~~~"), ENV),
    "four backticks": (fenced(ENV, "python", "````"), ENV),
    "no fence": (ENV, ENV),
    "no fence, prose before": (f"Here is the game:\n\n{ENV}", ENV),
    "no fence, prose after": (f"{ENV}\nThis game is won by luck, isn't it?\n", ENV),
    "usage in a second fence": (f"{fenced(ENV)}Use it so:\n{fenced(USAGE)}", ENV),
    "usage in the first fence": (f"{fenced(USAGE)}The file:\n{fenced(ENV)}", ENV),
    "shell first": (fenced("pip install gymnasium\n", "bash") + fenced(ENV), ENV),
    "JSON first": (fenced("{}\n", "json") + fenced(ENV), ENV),
    "another language beside a map": (fenced("#..#\n", "") + fenced(ENV, "gymnasium"), ENV),
    "no fence, usage in one": (f"{ENV}\nUse it so:\n{fenced(USAGE)}", ENV),
    "another language, and broken": (fenced(BROKEN, "text"), BROKEN),
    "a sketch, then the whole": (f"{fenced(HELPER)}{fenced(ENV)}", ENV),
    "the whole in two parts": (
        fenced(ENV.split("    def step", maxsplit=1)[0]) + fenced("    def step" + ENV.split("    def step")[1]),
        ENV.split("    def step", maxsplit=1)[0].rstrip("\n") + "\n\n\n    def step" + ENV.split("    def step")[1],
    ),
    "two versions": (f"{fenced(ENV)}Better:\n{fenced(OTHER)}", OTHER),
    "Harmony": (HARMONY + fenced(ENV) + "<|return|>", ENV),
    "Harmony without a fence": (HARMONY + ENV + "<|return|>", ENV),
    "Harmony, the end only": (fenced(ENV) + "<|end|>", ENV),
    "thinking": (f"<think>{fenced(USAGE)}</think>{fenced(ENV)}", ENV),
    "thinking without an end": (f"{fenced(ENV)}<think>now what", ENV),
    "Windows lines": (fenced(ENV).replace("\n", "\r\n"), ENV),
    "a byte order mark": ("\ufeff" + fenced(ENV), ENV),
    "in a list": ("1. The file:\n" + "".join(f"   {line}\n" for line in fenced(ENV).splitlines()), ENV),
    "spaces that matter": (fenced(MAP), MAP),
    "never closed": (f"```python\n{ENV}", ENV),
    "a syntax error": (fenced(BROKEN), BROKEN),
    "another name": (fenced(OTHER), OTHER),
    "no base class": (fenced(PLAIN), PLAIN),
}
NOTHING = {
    "nothing": "",
    "refusal": "I'm sorry, I can't help with that.",
    "prose": "The game has a step and a reset, and a class for its bats.",
    "a fence without a class": fenced("print('hello')\n"),
    "a helper alone": fenced("class Bat:\n    def fly(self):\n        return 1\n"),
    "JSON": '{"viable": true}',
    "only thoughts": f"<think>{fenced(ENV)}</think>",
}


@pytest.mark.parametrize("name", CASES)
def test_the_environment_is_extracted(name: str) -> None:
    text, wanted = CASES[name]
    found = extraction.environment(text)
    assert found is not None
    lines = [line.rstrip() for line in found.source.splitlines() if line.strip()]
    assert lines == [line.rstrip() for line in wanted.splitlines() if line.strip()]


@pytest.mark.parametrize("name", NOTHING)
def test_text_without_an_environment(name: str) -> None:
    assert extraction.environment(NOTHING[name]) is None


@pytest.mark.parametrize(
    ("source", "name"),
    [
        (ENV, ""),
        (OTHER, ""),
        (f"{OTHER}\n{ENV}".replace("import gymnasium as gym\n\n\nclass Game", "class Game"), "GameEnv"),
        (f"{OTHER}\n{OTHER.replace('CaveEnv', 'MineEnv')}", "MineEnv"),
        (
            ENV.replace("GameEnv", "BaseEnv")
            + "\n\nclass GameEnv(BaseEnv):\n    def step(self, action):\n        pass\n",
            "",
        ),
        (ENV + "\n\nclass _Debug(gym.Env):\n    def step(self, action):\n        pass\n", ""),
    ],
    ids=["one", "another name", "several, one as asked", "several", "a base", "private"],
)
def test_one_of_several_classes_is_chosen(source: str, name: str) -> None:
    found = extraction.environment(fenced(source))
    assert found is not None
    assert found.name == name


@pytest.mark.parametrize(
    ("cut", "more"),
    [
        (f"```python\n{ENV[:90]}", f"{ENV[90:]}```\n"),
        (f"```python\n{ENV[:90]}", f"```python\n{ENV[90:]}```\n"),
        (f"```python\n{ENV[:90]}", f"{ENV[70:]}```\n"),
        (f"```python\n{ENV[:90]}", f"Here is the rest:\n\n```python\n{ENV[60:]}```\n"),
        (f"```python\n{ENV[:130]}", f"{ENV[130:]}"),
    ],
    ids=["as asked", "another fence", "said again", "prose, another fence, said again", "never closed"],
)
def test_continuations_are_joined(cut: str, more: str) -> None:
    assert extraction.is_unfinished(cut)
    found = extraction.environment(extraction.join(cut, more))
    assert found is not None
    assert found.source == ENV


def test_endless_repetition_is_extracted_in_linear_time() -> None:
    began = time.process_time()
    assert extraction.environment("```python\nx = 1\n```\n" * 30_000) is None
    assert time.process_time() - began < 4


def test_a_closed_fence_is_finished() -> None:
    assert not extraction.is_unfinished(fenced(ENV))
    assert not extraction.is_unfinished("no code at all")


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (fenced("class Policy:\n    def act(self, state):\n        return [0, 0, 0]\n"), True),
        (fenced("def policy(env):\n    return [0, 0, 0]\n"), True),
        (fenced(ENV) + fenced("class Player:\n    def act(self, state):\n        return [1, 0, 0]\n"), True),
        (fenced(ENV), False),
        ("Hold the key.", False),
    ],
)
def test_policies(text: str, found: bool) -> None:
    told = extraction.policy(text)
    assert (told is not None) == found
    assert told is None or "GameEnv" not in told.source
