"""Validation from Python: files, texts, classes and ids; a drop-in check_env; reports that show themselves."""

from __future__ import annotations

import importlib
import io
import re
import subprocess
import sys
import textwrap
import types
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from rich.console import Console

import envcraft
from envcraft.api.cells import Cells
from envcraft.api.extraction import needed, target_of
from envcraft.judging.engine import Plan
from envcraft.judging.engine import validate as judge
from envcraft.model.target import Kind
from envcraft.model.verdict import CheckReport, Finding, Ignored, Severity, Verdict
from tests.envcraft.conftest import ENVIRONMENT

_CHEAP: dict[str, Any] = {"sandbox": "process", "budget": "quick", "checks": ["source", "reward"]}
_BROKEN = ENVIRONMENT.replace("float(won), won", "float('nan'), won")
_SCRIPT = """import os
import random

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 5
SIZE += 2
UNUSED = os.environ.get("HOME")


def frame():
    return np.zeros((SIZE, SIZE), np.uint8)


class Room(gym.Env):
    def reset(self, *, seed=None, options=None):
        return frame(), {}


if __name__ == "__main__":
    print(Room())
"""


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)


def codes(report: Any) -> set[str]:
    return {finding.code for subject in report.reports for check in subject.checks for finding in check.findings}


def test_a_file_a_text_and_an_id_are_judged(tmp_path: Path) -> None:
    (tmp_path / "walk.py").write_text(_BROKEN)
    assert codes(envcraft.validate(tmp_path / "walk.py", **_CHEAP)) >= {"EC301"}
    assert codes(envcraft.validate(_BROKEN, **_CHEAP)) >= {"EC301"}
    report = envcraft.validate("CartPole-v1", contract="gymnasium", **{**_CHEAP, "checks": ["source"]})
    assert report.reports[0].env_class == "CartPoleEnv"
    with pytest.raises(envcraft.UsageError, match="did you mean arcade"):
        envcraft.validate("CartPole-v1", contract="arcaed", **_CHEAP)
    with pytest.raises(envcraft.UsageError, match="defines no class Run; its classes are Walk"):
        envcraft.validate(tmp_path / "walk.py", env_class="Run", **_CHEAP)


def test_the_text_of_a_report_is_no_display_of_a_notebook(monkeypatch: pytest.MonkeyPatch) -> None:
    report = envcraft.validate(ENVIRONMENT, **_CHEAP)
    text = str(report)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert "PASS" in text
    assert str(report) == text


def test_a_report_shows_itself() -> None:
    report = envcraft.validate(_BROKEN, **_CHEAP)
    assert "EC301" in str(report)
    assert "return self.render(), float('nan'), won" in str(report)
    assert "--format" not in str(report)
    assert "envcraft explain CODE" in str(report)
    assert repr(report) == "<Report: 0 passed, 1 failed, 0 undecided>"
    assert report.outcome == "fail"
    assert report._repr_html_().startswith("<iframe srcdoc=")
    assert "EC301" in report._repr_html_()
    console = Console(width=60, record=True, file=io.StringIO())
    console.print(report)
    assert "EC301" in console.export_text()


def test_a_class_of_a_script_is_judged_from_its_source(tmp_path: Path) -> None:
    """The class of __main__ is judged without running the script again, and findings name the script's lines."""
    text = _BROKEN.replace('"""A walk', 'print("once")\n"""A walk') + (
        "\nimport envcraft\n"
        "report = envcraft.validate(Walk, sandbox='process', budget='quick', checks=['source', 'reward'])\n"
        "for check in report.reports[0].checks:\n"
        "    for finding in check.findings:\n"
        "        print(finding.code, finding.line, report.reports[0].path)\n"
        "print(report)\n"
    )
    (tmp_path / "play.py").write_text(text)
    done = subprocess.run([sys.executable, "play.py"], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    first, *found = done.stdout.splitlines()
    assert first == "once"
    line = next(number for number, words in enumerate(text.splitlines(), 1) if "float('nan')" in words)
    assert f"EC301 {line} {tmp_path / 'play.py'}" in found
    assert f"      {line} | {text.splitlines()[line - 1].strip()}" in found


def test_a_class_of_a_notebook_is_judged_from_its_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    imports, _, rest = ENVIRONMENT.partition("\n\n\n")
    cells = [
        imports,
        "%matplotlib inline\nSTEPS = 7",
        "1 / 0",
        rest.replace("self.steps >= 100", "self.steps >= STEPS"),
    ]
    module = types.ModuleType("__main__")
    vars(module)["In"] = ["", *cells]
    monkeypatch.setitem(sys.modules, "__main__", module)
    for number in (0, 3):
        types.FunctionType(compile(cells[number], f"<ipython-input-{number}>", "exec"), vars(module))()
    report = envcraft.validate(vars(module)["Walk"], **{**_CHEAP, "checks": ["source", "termination"]})
    assert (report.reports[0].path, report.reports[0].env_class) == ("Walk (notebook).py", "Walk")
    assert report.reports[0].steps > 0
    assert codes(report) <= {"EC503"}


def test_lines_of_a_notebook_count_within_their_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the notebook numbers them: other cells that ran before do not move them."""
    imports, _, rest = ENVIRONMENT.partition("\n\n\n")
    helper = "import random\ndef paid(x):\n    luck = random.random()\n    return luck / (7 - x)"
    history = [
        "",
        imports,
        "%matplotlib inline\nSTEPS = 7",
        helper,
        rest.replace("float(won), won", "paid(self.x), won"),
    ]
    module = types.ModuleType("__main__")
    vars(module)["In"] = history
    monkeypatch.setitem(sys.modules, "__main__", module)
    for number in (1, 3, 4):
        types.FunctionType(compile(history[number], f"/tmp/ipykernel_1/{number}.py", "exec"), vars(module))()
    kind = vars(module)["Walk"]
    report = envcraft.validate(kind, **{**_CHEAP, "checks": ["source", "api", "lint"]})
    found = {finding.code: finding for check in report.reports[0].checks for finding in check.findings}
    assert (found["EC107"].line, found["EC107"].evidence["cell"]) == (4, "In [3]")
    returned = next(number for number, words in enumerate(history[4].splitlines(), 1) if "paid(" in words)
    assert f"  In [4], line {returned}, in step\n" in found["EC107"].evidence["traceback"]
    assert found["EC050"].message.startswith("line 3 takes a number")
    shown = str(report).splitlines()
    place = next(number for number, line in enumerate(shown) if "EC107" in line)
    assert shown[place].endswith(" In [3], line 4")
    assert shown[place + 2] == "      4 | return luck / (7 - x)"
    assert "In [3], line 4" in report._repr_html_()
    with pytest.raises(envcraft.CheckFailed, match=r"In \[3\], line 4: EC107 .*\n  4 \|     return luck / \(7 - x\)"):
        envcraft.check_env(kind, contract="arcade", sandbox="process")


def test_lines_of_other_cells_have_the_names_of_these() -> None:
    cells = Cells("Walk (notebook).py", {"In [2]": 1, "In [4]": 11})
    evidence = {"lines": [12, 3, [14, 15]], "traceback": '  File "/job/Walk (notebook).py", line 3, in step'}
    words = "line 12 reads BOARD (also line 14, 15), and line 3 writes it; core.py line 20 does not"
    raised = "reset() (Walk (notebook).py:4) raises ValueError: line 12 column 3"
    check = CheckReport(
        "lint",
        Verdict.FAIL,
        findings=[Finding("A", Severity.ERROR, words, 12, evidence), Finding("B", Severity.ERROR, raised)],
        ignored=[Ignored(Finding("C", Severity.ERROR, "lines 12-13", 13), "", 14)],
        reason="lines 2-3 were never reached",
    )
    cells.within(check)
    first, second = check.findings
    assert (
        first.message == "line 2 reads BOARD (also line 4, 5), and In [2], line 3 writes it; core.py line 20 does not"
    )
    assert (first.line, first.evidence["cell"]) == (2, "In [4]")
    assert first.evidence["lines"] == [2, "In [2], line 3", [4, 5]]
    assert first.evidence["traceback"] == "  In [2], line 3, in step"
    assert second == Finding("B", Severity.ERROR, "reset() (In [2], line 4) raises ValueError: line 12 column 3")
    assert check.ignored == [Ignored(Finding("C", Severity.ERROR, "lines 2-3", 3, {"cell": "In [4]"}), "", 4)]
    assert check.reason == "In [2], lines 2-3 were never reached"


def test_only_what_the_class_needs_is_kept_in_its_lines() -> None:
    kept = needed(_SCRIPT, "Room").splitlines()
    assert len(kept) == len(_SCRIPT.splitlines())
    assert [line for line in kept if line and not line.startswith(" ")] == [
        "import gymnasium as gym",
        "import numpy as np",
        "SIZE = 5",
        "SIZE += 2",
        "def frame():",
        "class Room(gym.Env):",
    ]
    assert all(line in ("", original) for line, original in zip(kept, _SCRIPT.splitlines(), strict=True))
    with pytest.raises(envcraft.UsageError, match="needs np, and no statement"):
        needed(_SCRIPT.replace("import numpy as np", ""), "Room", frozenset({"np"}))
    with pytest.raises(envcraft.UsageError, match=r"no statement of its module binds the class Dyn .*; define it"):
        needed(_SCRIPT, "Dyn", frozenset({"np"}))


#: Statements of scripts; those that the class Room needs end in a plus.
_SCRIPTS = {
    "locals": """
        class Room: # +
            def step(self): reward = 0.0; return reward # +
        obs, reward = Room().step()
        def play(): return Room()
        """,
    "locals under any other condition": """
        class Room: # +
            def step(self): reward = 0.0; return reward # +
        if True:
            reward = Room().step()
        """,
    "attributes and arguments": """
        class Room: # +
            size = 3 # +
            def step(self, action, *, seed=None): return self.size, action, seed # +
        size = action = seed = Room().step(1)
        """,
    "closures": """
        class Room: # +
            def step(self): # +
                total = 3 # +
                def more(): return total # +
                return more() # +
        total = more = Room().step()
        """,
    "comprehensions": """
        WIDTH = 3 # +
        ROWS = [cell for cell in range(WIDTH)] # +
        class Room: # +
            cells = [cell for cell in ROWS] # +
            def step(self): return {i: j for i, j in enumerate(self.cells)} # +
        for cell in i, j in [(1, 2)]:
            print(cell)
        """,
    "class-level names": """
        low = 3 # +
        size = 5
        class Room: # +
            size = 4 # +
            width = size # +
            low = low + 1 # +
        width = Room.width
        """,
    "decorators, bases and defaults": """
        def marked(kind): return kind # +
        class Base: # +
            def reset(self): return helper() # +
        SIZE = 5 # +
        @marked # +
        class Room(Base): # +
            def step(self, size=SIZE): return size # +
        def helper(): return LATE # +
        LATE = 3 # +
        """,
    "annotations": """
        from __future__ import annotations # +
        from typing import TYPE_CHECKING # +
        if TYPE_CHECKING: # +
            from numpy import ndarray # +
        class Room: # +
            size: Wide # +
            def step(self) -> ndarray: return 3 # +
        Wide = int # +
        """,
    "global": """
        class Room: # +
            def step(self): # +
                global count, last # +
                last = count = count + 1 # +
                return last # +
        count = 0 # +
        """,
    "a value before the class and a later one": """
        SIZE = 5 # +
        class Room: # +
            size = SIZE # +
        SIZE = Room().size
        """,
    "a value that a method reads, bound anew": """
        SIZE = 5
        class Room: # +
            def step(self): return SIZE # +
        SIZE = 6 # +
        """,
    "a value from itself, from a condition, and changed": """
        LEVELS = {} # +
        LEVELS["a"] = 3 # +
        SIZE = 5 # +
        SIZE = SIZE + 2 # +
        if SIZE > 6: # +
            LEVELS = {"b": 4} # +
        match SIZE: # +
            case 7: SIZE = 8 # +
        class Room: # +
            def step(self): return LEVELS, SIZE # +
        Room.metadata = {} # +
        Other = Room().step()
        Other.metadata = {}
        """,
    "a function that the class body calls": """
        SIZE = 5 # +
        def frame(): return SIZE # +
        class Room: # +
            space = frame() # +
        SIZE = 6 # +
        """,
    "a name that hides a builtin": """
        class Room: # +
            size = max(3, 4) # +
        max = Room.size
        """,
    "a cell that ran twice": """
        class Room:
            size = wrong()
        class Room: # +
            size = 3 # +
        """,
    "a cell that awaits": """
        class Room: # +
            size = 3 # +
        await play(Room())
        """,
    "a comparison that Python warns of": """
        class Room: # +
            def step(self): return 3 is 3 # +
        """,
    "an import of all names": """
        from gymnasium import * # +
        class Room(Env): # +
            size = 3 # +
        """,
}


@pytest.mark.parametrize("script", _SCRIPTS.values(), ids=_SCRIPTS)
def test_only_the_global_names_of_a_class_are_needed(script: str) -> None:
    script = textwrap.dedent(script).lstrip()
    kept = [line if line.endswith("# +") else "" for line in script.splitlines()]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert needed(script, "Room", frozenset({"Env", "Room", "last"})).splitlines() == kept


@pytest.mark.parametrize(
    "binding", ["if __name__ == '__main__':\n    SIZE = 5", "def start():\n    global SIZE\n    SIZE = 5"]
)
def test_a_name_that_an_importer_does_not_have_is_named(binding: str) -> None:
    script = f"class Room:\n    def step(self): return SIZE\n{binding}\n"
    with pytest.raises(envcraft.UsageError, match=r"Room needs SIZE, and no statement .* bind it at the top level"):
        needed(script, "Room", frozenset({"SIZE"}))


def test_a_script_that_steps_its_environment_is_judged(tmp_path: Path) -> None:
    """Its variables have the names of the locals of step(), as in most scripts."""
    text = ENVIRONMENT.replace("won = ", "won = terminated = ") + (
        "\nimport envcraft\n"
        "env = Walk()\n"
        "env.reset(seed=0)\n"
        "obs, reward, won, terminated, info = env.step(env.action_space.sample())\n"
        "print(envcraft.validate(Walk, sandbox='process', budget='quick', checks=['source', 'reward']))\n"
    )
    (tmp_path / "play.py").write_text(text)
    done = subprocess.run([sys.executable, "play.py"], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert "1 passed" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("script", "kept"),
    [
        ("import gymnasium as gym, envcraft", "import gymnasium as gym"),
        ("from gymnasium import (\n    Env as gym,\n    make,\n)", "from gymnasium import Env as gym\n\n\n"),
        ("import os; import gymnasium as gym, sys", "import gymnasium as gym"),
        ("import gymnasium as gym; SIZE = 5", "import gymnasium as gym; SIZE = 5"),
    ],
)
def test_an_import_of_several_names_keeps_only_those_that_the_class_needs(script: str, kept: str) -> None:
    """A script imports EnvCraft beside Gymnasium; the class is not to blame for that."""
    room = "\n\nclass Room(gym.Env):\n    size = 3\n"
    assert needed(script + room, "Room") == kept + room


def test_names_of_checks_are_a_list_or_a_text() -> None:
    listed, named = (
        envcraft.validate(_BROKEN, **{**_CHEAP, "checks": checks}, skip=skip)
        for checks, skip in ((["source", "reward", "lint"], ["lint"]), ("source, reward,lint", "lint"))
    )
    assert [check.check for check in named.reports[0].checks] == [check.check for check in listed.reports[0].checks]
    with pytest.raises(envcraft.UsageError, match="there is no check 'rewrad'; did you mean reward"):
        envcraft.validate(_BROKEN, **{**_CHEAP, "checks": "rewrad"})


def test_a_class_in_a_function_has_no_source() -> None:
    class Inner(gymnasium.Env[Any, Any]):
        pass

    with pytest.raises(envcraft.UsageError, match="inside a function"):
        target_of(Inner)


@pytest.mark.parametrize("env", ["CartPole-v1", gymnasium.make("CartPole-v1").unwrapped.__class__])
def test_check_env_judges_ids_and_classes(env: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = _only(monkeypatch)
    envcraft.check_env(env, sandbox="process")
    assert seen[0].kind is (Kind.ID if isinstance(env, str) else Kind.MODULE)


def test_check_env_judges_an_instance_with_its_own_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = _only(monkeypatch)
    env = gymnasium.make("FrozenLake-v1", map_name="8x8", render_mode="ansi")
    envcraft.check_env(env, sandbox="process")
    assert (seen[0].path, seen[0].kwargs["map_name"]) == ("gymnasium:FrozenLake-v1", "8x8")
    assert "render_mode" not in seen[0].kwargs
    with pytest.warns(UserWarning, match="without its wrappers: FlattenObservation"):
        envcraft.check_env(gymnasium.wrappers.FlattenObservation(env), sandbox="process")


_SIZED = ENVIRONMENT.replace("def __init__(self", "def __init__(self, size=5").replace(
    "self.action_space =", "self.size = size\n        self.action_space =", 1
)


def _sized(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str = _SIZED) -> Any:
    (tmp_path / "sized.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "sized", raising=False)
    importlib.invalidate_caches()
    return importlib.import_module("sized").Walk


def test_check_env_says_that_an_instance_s_arguments_are_not_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, seen = _sized(tmp_path, monkeypatch), _only(monkeypatch)
    with pytest.warns(UserWarning, match=r"Walk\(\) is judged with the defaults of size.*kwargs=\{'size'") as caught:
        envcraft.check_env(kind(size=7), sandbox="process")
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Its attribute shows the default.
        envcraft.check_env(kind(), sandbox="process")
        envcraft.check_env(kind(size=7), sandbox="process", kwargs={"size": 7})
    assert [target.kwargs for target in seen] == [{}, {}, {"size": 7}]


def test_check_env_judges_an_instance_with_the_arguments_of_its_spec(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, seen = _sized(tmp_path, monkeypatch), _only(monkeypatch)
    env = gymnasium.make(gymnasium.envs.registration.EnvSpec("Sized-v0", entry_point=kind, kwargs={"size": 9}))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        envcraft.check_env(env, sandbox="process")
    assert seen[0].kwargs == {"size": 9}


def test_check_env_of_an_instance_asks_for_arguments_that_have_no_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = _sized(tmp_path, monkeypatch, _SIZED.replace("size=5", "size"))
    with pytest.raises(
        envcraft.UsageError,
        match=r"Walk\(\) needs size, and an instance does not say.*give them: kwargs=\{'size': \.\.\.\}",
    ):
        envcraft.check_env(kind(7), sandbox="process")


def test_check_env_raises_with_the_findings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    no_environment: Any = 3
    (tmp_path / "broken_walk.py").write_text(_BROKEN.replace("def close", "def shut"))
    monkeypatch.syspath_prepend(tmp_path)
    kind = importlib.import_module("broken_walk").Walk
    _only(monkeypatch, "reward")
    with pytest.raises(AssertionError, match=r"broken_walk.*EC301") as caught:
        envcraft.check_env(kind(), sandbox="process")
    assert isinstance(caught.value, envcraft.CheckFailed)
    assert "EC301" in codes(caught.value.report)
    with pytest.raises(envcraft.UsageError, match=r"not a gymnasium\.Env; .* its class, its id or its file"):
        envcraft.check_env(no_environment)


def test_check_env_shows_the_evidence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "walk.py").write_text(ENVIRONMENT.replace("won = ", "won = {}[self.x] or ", 1))
    _only(monkeypatch, "api")
    with pytest.raises(envcraft.CheckFailed) as caught:
        envcraft.check_env("walk.py", sandbox="process")
    lines = str(caught.value).splitlines()
    number = next(index for index, line in enumerate(lines) if "raises KeyError" in line)
    assert re.match(r"  \d+ \|         won = \{\}\[self\.x\]", lines[number + 1])
    assert re.match(r'    File "walk\.py", line \d+, in step', lines[number + 2])
    assert any(line.startswith("  fix: ") for line in lines[number + 3 :])


def test_check_env_keeps_a_limit_of_steps(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    kind, _ = _sized(tmp_path, monkeypatch, ENVIRONMENT), _only(monkeypatch)
    limits: list[Any] = []

    def judged(plan: Plan, *args: Any, **kwargs: Any) -> Any:
        limits.append(plan.contract.adapter.get("limit"))
        return judge(plan, *args, **kwargs)

    monkeypatch.setattr("envcraft.api.validation.judge", judged)
    monkeypatch.setattr(gymnasium.envs.registration, "registry", registry := dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", registry)
    gymnasium.register("zz/Walk-v0", kind, max_episode_steps=7)
    limited, cartpole = gymnasium.wrappers.TimeLimit, gymnasium.make("CartPole-v1")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for env in (limited(kind(), 10), limited(limited(kind(), 9), 10), limited(cartpole, 8), cartpole):
            envcraft.check_env(env, sandbox="process")
        # No worker knows an id of a script.
        for name in ("zz/Walk-v0", gymnasium.make("zz/Walk-v0")):
            envcraft.check_env(name, sandbox="process")
    # CartPole's worker adds the limit of its id again.
    assert limits == [10, 9, 8, None, 7, 7]


@pytest.mark.parametrize(
    ("target", "options", "words"),
    [
        (None, {}, r"None is not a target; give a file"),
        ([], {}, "no target is given; give a file"),
        ([3], {}, "3 is not a target; give a file"),
        ("CartPole-v1", {"seed": -1}, "seed is -1; it must be a whole number from 0 to 2147483647"),
        ("CartPole-v1", {"seed": "x"}, "seed is 'x'; it must be a whole number"),
        ("CartPole-v1", {"workers": 0}, "workers is 0; it must be a whole number from 1 to 1024"),
        ("CartPole-v1", {"time_limit": -1}, "time_limit is -1; it must be a number above 0"),
        (
            "CartPole-v1",
            {"kwargs": '{"size": 8}'},
            r"kwargs is '{\"size\": 8}'; it must be a dict, such as {'size': 8}",
        ),
        ("CartPole-v1", {"kwargs": {"sise": 8}}, r"^kwargs: .* got an unexpected keyword argument 'sise'$"),
        ("CartPole-v1", {"wrappers": ["nomod:func"]}, "^wrappers: the module nomod of the wrapper nomod:func"),
        ("CartPole-v1", {"budget": 3}, "budget is 3; it must be quick, standard or thorough"),
        (
            "CartPole-v1",
            {"require_isolation": "vm"},
            "require_isolation is 'vm'; it must be container, namespace or proc",
        ),
        ("CartPole-v1", {"workers": 2000}, "workers is 2000; it must be a whole number from 1 to 1024"),
        ("CartPole-v1", {"time_limit": float("inf")}, "time_limit is inf; it must be a number above 0"),
        ("CartPole-v1", {"time_limit": True}, "time_limit is True; it must be a number above 0"),
        ("CartPole-v1", {"exclude": 3}, "exclude is 3; it must be a string or a list of strings"),
        ("CartPole-v1", {"checks": ["api", 3]}, r"checks is \['api', 3\]; it must be a string or a list of strings"),
        ("CartPole-v1", {"wrappers": {"a:b": 3}}, "wrappers is {'a:b': 3}; it must be a string or a list of strings"),
        ("CartPole-v1", {"exclude": [""]}, r"exclude is \[''\]; give a value, or leave it out"),
        ("CartPole-v1", {"env_class": ""}, "env_class is ''; give a value, or leave it out"),
        ("CartPole-v1", {"strict": "no"}, "strict is 'no'; it must be True or False"),
        ("CartPole-v1", {"fail_fast": "no"}, "fail_fast is 'no'; it must be True or False"),
        ("CartPole-v1", {"exitfirst": 0}, "exitfirst is 0; it must be True or False"),
        ("CartPole-v1", {"contract": 3}, "contract is 3; it must be a string"),
        ("CartPole-v1", {"sandbox": ["docker"]}, r"sandbox is \['docker'\]; it must be a string"),
        ("CartPole-v1", {"env_class": gymnasium.Env}, "env_class is <class .*; it must be a string"),
        ("CartPole-v1", {"kwargs": 3}, "kwargs is 3; it must be a dict"),
        (gymnasium.Env, {"env_class": "Cart"}, "env_class 'Cart' does not apply to the class Env; leave it out"),
        ("CartPole-v1", {"wrappers": ["TimeLimit"]}, "the wrapper 'TimeLimit' must be 'module:func'"),
    ],
)
def test_a_wrong_argument_is_named(target: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(envcraft.UsageError, match=words):
        envcraft.validate(target, **{**_CHEAP, **options})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"warn": "no"}, "warn is 'no'; it must be True or False"),
        ({"skip_render_check": "no"}, "skip_render_check is 'no'; it must be True or False"),
        ({"skip_close_check": 1}, "skip_close_check is 1; it must be True or False"),
        ({"budget": "huge"}, "budget is 'huge'; it must be quick, standard or thorough"),
        ({"seed": "3"}, "seed is '3'; it must be a whole number"),
    ],
)
def test_a_wrong_argument_of_check_env_is_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(envcraft.UsageError, match=words):
        envcraft.check_env("CartPole-v1", **options)


def test_validate_says_what_judges_an_instance() -> None:
    env: Any = gymnasium.make("CartPole-v1").unwrapped
    with pytest.raises(envcraft.UsageError, match=r"pass the class CartPoleEnv, or call envcraft.check_env\(env\)"):
        envcraft.validate(env, **_CHEAP)


def test_one_wrapper_needs_no_list() -> None:
    options = {**_CHEAP, "checks": ["source"], "contract": "gymnasium"}
    report = envcraft.validate("CartPole-v1", wrappers="gymnasium.wrappers:FlattenObservation", **options)
    assert report.reports[0].wrappers == ["gymnasium.wrappers:FlattenObservation"]


def test_a_class_of_a_folder_on_the_path_is_judged_from_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, seen = _sized(tmp_path, monkeypatch), _only(monkeypatch)
    # As with `python -m pytest tests`: the project comes after the folder of the tests.
    monkeypatch.syspath_prepend(tmp_path / "tests")
    envcraft.check_env(kind, sandbox="process")
    envcraft.check_env("CartPole-v1", sandbox="process")
    envcraft.check_env(type(gymnasium.make("CartPole-v1").unwrapped), sandbox="process")
    assert [target.kind for target in seen] == [Kind.SOURCE, Kind.ID, Kind.MODULE]


def test_check_env_takes_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = _only(monkeypatch)
    (tmp_path / "walk.py").write_text(ENVIRONMENT)
    envcraft.check_env("walk.py", sandbox="process")
    envcraft.check_env(tmp_path / "walk.py", sandbox="process")
    assert [target.kind for target in seen] == [Kind.SOURCE, Kind.SOURCE]
    (tmp_path / "other.py").write_text(ENVIRONMENT)
    with pytest.raises(envcraft.UsageError, match=r"holds 2 environments; check_env\(\) judges one"):
        envcraft.check_env(str(tmp_path), sandbox="process")


def _only(monkeypatch: pytest.MonkeyPatch, *names: str) -> list[Any]:
    """Let check_env run only the check `source` and those named, and keep the targets that it judges."""
    from envcraft.api import validation
    from envcraft.judging import engine
    from envcraft.judging.selection import select_checks

    seen: list[Any] = []

    def spy(plan: Any, workers: int | None = None, **options: Any) -> Any:
        seen.extend(plan.targets)
        return engine.validate(plan, workers, **options)

    monkeypatch.setattr(validation, "judge", spy)
    monkeypatch.setattr(validation, "select_checks", lambda *_: select_checks(",".join(["source", *names]), None))
    return seen
