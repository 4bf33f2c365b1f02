"""The command ``audit`` on small environments; a killed audit continues to the same result."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from envcraft.corpus.records import records_of
from envcraft.corpus.store import CorpusBusy, Store
from envcraft.errors import UsageError
from envcraft.model.target import MAX_SOURCE
from tests.killing import TIMES, Killed

from .conftest import ENVIRONMENT, QUICK, Invoke, judged, source, told


@pytest.fixture
def games(tmp_path: Path) -> Path:
    """Four small environments, one of which crashes, and two of which are the same."""
    folder = tmp_path / "games"
    (folder / "more").mkdir(parents=True)
    for name, crash in (("a.py", -1), ("b.py", 7), ("more/c.py", -2), ("more/d.py", -2)):
        (folder / name).write_text(f"{ENVIRONMENT.replace('CRASH', str(crash))}")
    return folder


def test_a_folder_is_followed(games: Path, invoke: Invoke) -> None:
    result = invoke("audit", "games", *QUICK, "--format", "json")
    first = json.loads(result.stdout)
    assert result.exit_code == 1, result.stderr
    assert [(report["path"], report["verdict"]) for report in first["reports"]] == [
        ("games/a.py", "pass"),
        ("games/b.py", "fail"),
        ("games/more/c.py", "pass"),
        ("games/more/d.py", "pass"),
    ]
    assert first["audit"]["judged"] == 3
    assert first["audit"]["codes"] == {"EC107": 1}
    (games / "baseline.json").write_text(result.stdout)

    (games / "b.py").write_text(ENVIRONMENT.replace("CRASH", "-3"))
    (games / "more" / "c.py").write_text(ENVIRONMENT.replace("CRASH", "7 "))
    (games / "more" / "d.py").unlink()
    result = invoke("audit", "games", *QUICK, "--format", "json", "--baseline", "games/baseline.json")
    second = json.loads(result.stdout)
    difference = second["audit"]["baseline"]
    assert second["audit"]["judged"] == 2
    assert [(item["path"], item["code"]) for item in difference["new"]] == [("games/more/c.py", "EC107")]
    assert [(item["path"], item["code"]) for item in difference["fixed"]] == [("games/b.py", "EC107")]
    assert (difference["unchanged"], difference["unknown"]) == (0, 0)
    assert told(second["reports"][:1]) == told(first["reports"][:1])

    result = invoke("audit", "games", *QUICK, "--exit-zero", "--baseline", "games/baseline.json")
    assert result.exit_code == 0
    assert "3 environments: 2 passed, 1 failed, 0 undecided\n0 judged now, 3 known" in result.stdout
    assert "`envcraft corpus list games --verdict fail` lists what failed" in result.stdout
    assert "1 new, 1 fixed, 0 unchanged" in result.stdout
    listed = invoke("corpus", "list", "games", "--verdict", "fail", "--format", "json")
    assert [row["name"] for row in json.loads(listed.stdout)] == ["more/c.py"]


#: The left or the right end wins, and the other one loses.
ENDS = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Ends(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.NAME, self.steps = 10, int(self.np_random.integers(2)) * 20, 0
        return self.render(), {"is_success": False}

    def step(self, action):
        self.steps += 1
        self.x += {3: -1, 4: 1}.get(int(action[0]), 0)
        won, over = self.x == self.NAME, self.x in (0, 20) or self.steps == 100
        return self.render(), float(won) - 0.01, over, False, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[40:44, self.x * 4 : self.x * 4 + 4] = 255
        frame[20:24, self.NAME * 4 : self.NAME * 4 + 4] = 160
        frame[0, : self.steps % 84] = 90
        return frame
"""


def test_a_policy_plays_where_it_can_and_is_part_of_the_settings(tmp_path: Path, invoke: Invoke) -> None:
    (tmp_path / "games").mkdir()
    for name, attribute in (("a.py", "goal"), ("b.py", "aim")):
        (tmp_path / "games" / name).write_text(ENDS.replace("NAME", attribute))
    policy = tmp_path / "player.py"
    policy.write_text("def policy(env):\n    return [4 if env.goal else 3, 0, 0]\n")
    options = ["--sandbox", "process", "--budget", "quick", "--checks", "difficulty", "--format", "json"]
    result = invoke("audit", "games", *options, "--policy", "player.py")
    reports = {report["path"]: report["checks"][1] for report in json.loads(result.stdout)["reports"]}
    assert result.exit_code == 0, result.output
    assert reports["games/a.py"]["verdict"] == "pass", reports
    assert reports["games/b.py"]["undecided"]
    assert "the policy cannot play this environment: the policy raises" in reports["games/b.py"]["reason"]
    assert not reports["games/b.py"]["findings"]

    def judged_again(*more: str) -> int:
        return int(json.loads(invoke("audit", "games", *options, *more).stdout)["audit"]["judged"])

    assert judged_again("--policy", "player.py") == 0
    assert judged_again() == 2
    policy.write_text("def policy(env):\n    return [4 if env.goal > 0 else 3, 0, 0]\n")
    assert judged_again("--policy", "player.py") == 2
    result = invoke("reverify", "games/.envcraft", "--policy", "player.py", "--sandbox", "process")
    assert result.exit_code == 0, result.output
    assert "other settings" not in result.output


def test_a_larger_budget_is_for_what_passes_the_smaller_one(games: Path, invoke: Invoke) -> None:
    (games / "b.py").write_text(f"import nothing_of_this_name\n{ENVIRONMENT}")
    options = ("--checks", "source", "--sandbox", "process", "--budget", "quick,standard", "--time-limit", "300")
    result = invoke("audit", "games", *options, "--fail-fast", "--format", "json")
    assert "budget quick: 4 environments, 3 of them to be judged" in result.stderr
    assert "budget standard: 3 environments, 2 of them to be judged" in result.stderr
    told = json.loads(result.stdout)
    assert (told["budget"], told["audit"]["verdicts"]) == ("quick,standard", {"pass": 3, "fail": 1})
    assert (told["audit"]["judged"], told["audit"]["out_of_time"]) == (5, 0)
    with Store(games / ".envcraft") as store:
        records = {record.path: record for record in records_of(store)}
    assert {name: record.settings.budget for name, record in records.items()} == {
        "a.py": "standard",
        "b.py": "quick",
        "more/c.py": "standard",
        "more/d.py": "standard",
    }
    assert [name for name, record in records.items() if record.fail_fast] == ["b.py"]
    assert "--fail-fast" in records["b.py"].command
    result = invoke("audit", "games", *options, "--fail-fast")
    assert "4 environments: 3 passed, 1 failed, 0 undecided\n0 judged now, 4 known" in result.stdout


@pytest.mark.parametrize(
    "options",
    [("--budget", "quick,quik"), ("--budget", "quick,quick"), ("--budget", ","), ("--time-limit", "0")],
)
def test_wrong_budgets_and_limits(games: Path, invoke: Invoke, options: tuple[str, str]) -> None:
    result = invoke("audit", "games", *options)
    assert result.exit_code == 2
    assert options[0] in result.stderr


def test_sources_of_a_corpus_in_the_folder_are_passed_over(games: Path, invoke: Invoke) -> None:
    with Store.create(games / "more" / "kept") as store:
        store.add("a.py", (games / "a.py").read_bytes())
    (games / "verdicts").mkdir()
    (games / "verdicts.py").write_text(ENVIRONMENT.replace("CRASH", "-4"))
    options = ("--checks", "source", "--sandbox", "process", "--budget", "quick")
    for judged_now in (4, 0):
        result = invoke("audit", "games", "--store", "games/verdicts", *options)
        assert result.exit_code == 0, result.output
        assert f"5 environments: 5 passed, 0 failed, 0 undecided\n{judged_now} judged now" in result.stdout
    assert invoke("corpus", "init", "new").exit_code == 0
    assert "1 environment added" in invoke("corpus", "add", "new", "games/more/kept/sources").stdout


def test_a_finding_whose_check_did_not_run_is_not_fixed(games: Path, invoke: Invoke) -> None:
    (games / "base.json").write_text(invoke("audit", "games", *QUICK, "--format", "json").stdout)
    (games / "b.py").write_text(f"import nothing_of_this_name\n{ENVIRONMENT}")
    result = invoke("audit", "games", *QUICK, "--format", "json", "--baseline", "games/base.json")
    difference = json.loads(result.stdout)["audit"]["baseline"]
    assert [item["code"] for item in difference["new"]] == ["EC002"]
    assert (difference["fixed"], difference["unknown"]) == ([], 1)


def test_an_audit_of_what_changed_says_that_nothing_did(games: Path, invoke: Invoke) -> None:
    none = invoke("audit", "games", *QUICK, "--only-failed")
    assert "4 environments: none with the verdict fail or error\nno verdict yet; leave out --only-failed" in none.stdout
    assert invoke("audit", "games", *QUICK).exit_code == 1
    result = invoke("audit", "games", *QUICK, "--changed")
    assert (result.exit_code, result.stdout) == (
        0,
        "nothing changed: 4 environments are up to date\nlast verdicts: 3 passed, 1 failed, 0 undecided\n",
    )
    both = invoke("audit", "games", *QUICK, "--changed", "--only-failed")
    assert both.stdout.startswith("4 environments: none with the verdict fail or error has changed\n")


def test_a_file_replaces_its_own_name_also_where_another_has_its_text(games: Path, invoke: Invoke) -> None:
    invoke("corpus", "init", "corpus")
    invoke("corpus", "add", "corpus", "games")
    (games / "a.py").write_bytes((games / "b.py").read_bytes())
    assert "has the same source as b.py and is skipped" in invoke("corpus", "add", "corpus", "games/a.py").stderr
    assert invoke("corpus", "add", "corpus", "games/a.py", "--replace").stdout.startswith("1 environment added")
    shown = [
        json.loads(invoke("corpus", "show", "corpus", name, "--format", "json").stdout) for name in ("a.py", "b.py")
    ]
    assert shown[0]["source"] == shown[1]["source"]


def test_a_corpus_is_made_filled_and_judged(games: Path, invoke: Invoke) -> None:
    assert invoke("corpus", "init", "corpus").exit_code == 0
    assert invoke("audit", "corpus", *QUICK).exit_code == 2
    added = invoke("corpus", "add", "corpus", "games", "--metadata", '{"model": "a"}')
    assert added.stdout == "3 environments added, 1 already present\n"
    assert "games/more/d.py has the same source as more/c.py and is skipped" in added.stderr
    assert invoke("corpus", "add", "corpus", "games").stdout == "0 environments added, 4 already present\n"
    (games / "a.py").write_text(ENVIRONMENT.replace("CRASH", "-9"))
    assert invoke("corpus", "add", "corpus", "games/a.py").exit_code == 2
    partly = invoke("corpus", "add", "corpus", "nowhere.py", "games/b.py")
    assert (partly.exit_code, partly.stdout) == (2, "0 environments added, 1 already present\n")
    assert "nowhere.py cannot be read" in partly.stderr
    assert invoke("corpus", "add", "corpus", "games/a.py", "--replace").exit_code == 0
    assert invoke("corpus", "add", "corpus", "games/a.py", "--replace", "--metadata", '{"model": "b"}').exit_code == 0
    assert json.loads(invoke("corpus", "show", "corpus", "a.py", "--format", "json").stdout)["origin"]["model"] == "b"
    assert "class    -\n" in invoke("corpus", "show", "corpus", "a.py").stdout
    assert invoke("audit", "corpus", *QUICK).exit_code == 1
    assert (
        invoke("corpus", "list", "corpus").stdout == "pass       a.py\nfail       b.py  EC107\npass       more/c.py\n"
    )
    assert invoke("corpus", "list", "corpus", "--code", "ec107").stdout == "fail       b.py  EC107\n"
    misspelt = invoke("corpus", "list", "corpus", "--code", "EC10")
    assert (misspelt.exit_code, misspelt.stdout) == (2, "")
    assert "there is no rule 'EC10'; did you mean EC" in misspelt.stderr
    assert invoke("corpus", "list", "corpus", "--code", "EC203").stdout == ""
    assert invoke("corpus", "list", "corpus", "--name", "m*").stdout == "pass       more/c.py\n"
    shown = invoke("corpus", "show", "corpus", "b.py")
    assert invoke("corpus", "show", "corpus", "b").stdout == shown.stdout
    assert "class    Walk\n" in shown.stdout
    assert re.search(r"^  EC107 error b\.py:\d+: ", shown.stdout, re.MULTILINE)
    assert '"model": "a"' in shown.stdout
    assert invoke("corpus", "show", "corpus", "b.py", "--source").stdout == (games / "b.py").read_text()
    assert json.loads(invoke("corpus", "show", "corpus", "b.py", "--format", "json").stdout)["verdict"] == "fail"
    assert invoke("corpus", "rm", "corpus", "b").exit_code == 0
    missing = invoke("corpus", "rm", "corpus", "b.py")
    assert (missing.exit_code, "`envcraft corpus list corpus` lists them" in missing.stderr) == (2, True)
    assert invoke("audit", "corpus", *QUICK).exit_code == 0
    assert invoke("corpus", "verify", "corpus").exit_code == 0


def test_another_class_is_another_environment(invoke: Invoke, tmp_path: Path) -> None:
    with Store.create(tmp_path / "corpus") as store:
        judged(store, "ant")
    (tmp_path / "ant").write_bytes(source("ant"))
    refused = invoke("corpus", "add", "corpus", "ant", "--class", "Bee")
    assert refused.exit_code == 2
    assert "ant has another class of this source in corpus; --replace replaces it by ant" in refused.stderr
    assert invoke("corpus", "list", "corpus").stdout == "pass       ant\n"
    assert invoke("corpus", "add", "corpus", "ant").stdout == "0 environments added, 1 already present\n"
    assert invoke("corpus", "add", "corpus", "ant", "--class", "Bee", "--replace").exit_code == 0
    assert invoke("corpus", "list", "corpus").stdout == "none       ant\n"
    with Store(tmp_path / "corpus") as store:
        assert list(records_of(store)) == []


def test_newlines_in_file_names_are_escaped(invoke: Invoke, tmp_path: Path) -> None:
    with Store.create(tmp_path / "corpus") as store:
        store.add("odd\nname.py", source("ant"))
    for text in (source("bee"), b"#" * (MAX_SOURCE + 1)):
        (tmp_path / "odd\nname.py").write_bytes(text)
        refused = invoke("corpus", "add", "corpus", "odd\nname.py")
        assert refused.exit_code == 2
        assert len(refused.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["audit", "nowhere"], "nowhere does not exist; name a corpus or a folder"),
        (["audit", "games/a.py"], "neither a corpus nor a folder"),
        (["audit", "games/more", "--baseline", "none.json"], "does not exist"),
        (["audit", "games/more", "--baseline", "games/a.py"], "is not a report"),
        (["audit", "empty"], "holds no environment"),
        (["audit", "corpus", "--store", "other"], "leave out --store"),
        (["audit", "games", "--store", "corpus"], "need a separate corpus"),
        (
            ["corpus", "list", "games"],
            "games is not a corpus but a folder of Python files; `envcraft audit games` judges",
        ),
        (["export", "games", "--to", "site", "--output", "site"], "files; `envcraft audit games` judges them"),
        (["corpus", "list", "empty"], "empty is not a corpus but a folder without Python files; `envcraft corpus init"),
        (["corpus", "list", "nowhere"], "it does not exist; `envcraft corpus init nowhere` makes one"),
        (["corpus", "list", "games/a.py"], "games/a.py is not a corpus but a file"),
        (["corpus", "show", "corpus", "x"], "has no environment x"),
        (["corpus", "add", "corpus", "empty"], "holds no environment"),
        (["corpus", "add", "corpus", "games", "kept"], "kept is a corpus; `envcraft corpus merge corpus kept` adds"),
        (["corpus", "add", "corpus", "games/a.py", "--metadata", "[]"], "is not a JSON object"),
        (["corpus", "init", "games"], "is not empty"),
    ],
)
def test_usage_errors_are_one_line(games: Path, invoke: Invoke, arguments: list[str], words: str) -> None:
    (games.parent / "empty").mkdir()
    invoke("corpus", "init", "corpus")
    invoke("corpus", "init", "kept")
    result = invoke(*arguments, *(("--sandbox", "process") if arguments[0] == "audit" else ()))
    assert result.exit_code == 2, result.output
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_audit_ignores_settings_of_validate(games: Path, invoke: Invoke) -> None:
    settings = '[tool.envcraft]\nformat = "sarif"\nenvironments-only = true\nchecks = ["source"]\n'
    (games.parent / "pyproject.toml").write_text(settings)
    result = invoke("audit", "games", "--sandbox", "process", "--budget", "quick", "--changed")
    assert result.exit_code == 0, result.output
    assert "4 environments: 4 passed" in result.stdout
    (games.parent / "pyproject.toml").write_text("[tool.envcraft]\nbaselin = 1\n")
    assert "did you mean baseline?" in invoke("audit", "games").stderr


def audited(folder: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "envcraft", "audit", str(folder), *QUICK, *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder.parent)


def database(folder: Path) -> tuple[list[Any], list[Any]]:
    """All rows without times: environments with their verdicts, and findings."""
    with Store(folder) as store:
        found = store.db.execute(
            "SELECT name, e.source, e.class, s.digest, v.verdict, v.steps, v.report FROM environments e "
            "LEFT JOIN verdicts v ON v.id = e.verdict LEFT JOIN settings s ON s.id = v.settings ORDER BY name"
        )
        rows: list[Any] = [[*row[:-1], told(json.loads(row[-1] or "null"))] for row in found]
        findings = store.db.execute(
            "SELECT v.source, number, rule_check, code, severity, line, message FROM findings f "
            "JOIN verdicts v ON v.id = f.verdict ORDER BY 1, 2"
        )
        return rows, list(findings)


def judged_in(folder: Path) -> int:
    """The number of environments with a verdict, in a store that may not exist yet or be locked."""
    # During the creation of its tables, the folder is not yet a corpus.
    with contextlib.suppress(UsageError, CorpusBusy):
        return sum(row[4] is not None for row in database(folder)[0])
    return 0


def test_killed_at_any_moment_and_resumed_gives_the_same_rows(tmp_path: Path) -> None:
    games = [tmp_path / "undisturbed" / "games", tmp_path / "killed" / "games"]
    total = 24
    for folder in games:
        folder.mkdir(parents=True)
        for number in range(total):
            crash = 7 if number % 3 == 0 else -number
            (folder / f"e{number}.py").write_text(f"{ENVIRONMENT.replace('CRASH', str(crash))}\n# {number}\n")
    started = time.monotonic()
    assert audited(games[0]).wait(400) == 1
    each = (time.monotonic() - started) / total
    wanted = database(games[0])
    judged: list[int] = []
    lock = games[1] / ".envcraft" / "lock"
    killed = Killed(
        lambda: audited(games[1]),
        lambda pid: lock.is_file() and lock.read_text() == str(pid),
        12 * each,
        lambda: judged.append(judged_in(games[1])),
    )
    killed.run()
    # The earlier verdicts remain.
    assert judged == sorted(judged)
    assert killed.moments.total() == TIMES
    resumed = audited(games[1], "--format", "json")
    out, error = resumed.communicate(timeout=400)
    assert resumed.returncode == 1, error
    assert json.loads(out)["audit"]["judged"] == total - judged[-1]
    print("judged after each kill:", *judged, killed.moments)
    assert database(games[1]) == wanted


def test_ctrl_c_keeps_what_was_judged(games: Path) -> None:
    process = audited(games, "--no-resume")
    for _ in range(600):
        if judged_in(games):
            break
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=480)
    if process.returncode != 1:
        assert process.returncode == 130
        assert "stored; the same command judges all again, and without --no-resume only" in error
    again = audited(games, "--format", "json")
    out, error = again.communicate(timeout=480)
    assert again.returncode == 1, error
    assert json.loads(out)["audit"]["judged"] < 3


def test_two_audits_at_once_are_one_too_many(games: Path) -> None:
    process = audited(games)
    lock = games / ".envcraft" / "lock"
    for _ in range(600):
        if lock.is_file() and lock.read_text():
            break
        time.sleep(0.02)
    # On a busy machine it could end before the other one starts.
    process.send_signal(signal.SIGSTOP)
    other = audited(games)
    _, error = other.communicate(timeout=480)
    process.send_signal(signal.SIGCONT)
    assert other.returncode == 3
    assert f"process {process.pid} is writing to the corpus" in error
    assert process.wait(240) == 1


def test_digests_of_sources_are_those_of_their_files(games: Path, invoke: Invoke) -> None:
    invoke("audit", "games", *QUICK, "--checks", "source")
    listed: list[dict[str, Any]] = json.loads(invoke("corpus", "list", "games", "--format", "json").stdout)
    files = [file for file in games.rglob("*.py") if ".envcraft" not in file.parts]
    assert {row["name"]: row["source"] for row in listed} == {
        str(file.relative_to(games)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files
    }
