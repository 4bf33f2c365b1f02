"""``envcraft.make``: whose code runs in this process, and that it is what was judged, bit by bit."""

from __future__ import annotations

import hashlib
import importlib._bootstrap_external as bootstrap
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xxhash
from envcraft_protocol.adapters import StepLimit

import envcraft
from envcraft.contracts.builtin import ARCADE, ARCADE_NATIVE
from envcraft.corpus.export.exporter import Order
from envcraft.corpus.store import CorpusDamaged, Store
from envcraft.environments import loading
from envcraft.environments.sources import Untrusted, resolve
from envcraft.errors import EnvironmentFailed, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.selection import driver_named
from envcraft.judging.settings import Settings, contract_digest
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.rollout import Rollout
from envcraft.model.target import Target
from envcraft.model.verdict import Verdict
from envcraft.spaces.codec import ValueCodec

from .conftest import game, judged


def test_importing_the_package_imports_nothing() -> None:
    code = (
        "import sys, envcraft\n"
        "print(sorted({'numpy', 'gymnasium', 'msgspec', 'click'} & set(sys.modules)), dir(envcraft))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=True).stdout
    assert told.startswith("[] ")
    assert "'make', 'make_vec', 'names', 'register'" in told
    with pytest.raises(AttributeError, match="made"):
        envcraft.made  # noqa: B018


def _texts(corpus: Path, *names: str) -> list[str]:
    with Store(corpus) as store:
        find = "SELECT source FROM environments WHERE name = ?"
        return [store.source(store.db.execute(find, (name,)).fetchone()[0]).decode() for name in names]


def test_an_object_in_place_of_a_file_is_a_sentence() -> None:
    words = "Settings is a Python object, and envcraft.make takes a file, or an environment of a corpus"
    with pytest.raises(UsageError, match=words):
        envcraft.make(Settings)  # type: ignore[arg-type]


class TestTrust:
    def test_what_has_passed_runs_here(self, corpus: Path) -> None:
        env = envcraft.make(corpus, "ant")
        assert env.reset(seed=1)[0].shape == (84, 84, 3)
        assert type(env.unwrapped).__name__ == "Ant"
        assert env.unwrapped.render_mode == "rgb_array"
        assert type(env.unwrapped) is type(envcraft.make(corpus, "ant.py").unwrapped)

    @pytest.mark.parametrize("name", ["failed", "new"])
    def test_what_has_not_passed_is_not_even_imported(self, corpus: Path, name: str) -> None:
        step = {"failed": f"corpus show {corpus} failed.py` says why", "new": f"audit {corpus}` judges it"}[name]
        with pytest.raises(Untrusted, match=f"`envcraft {re.escape(step)}.*sandbox='auto'.*trust=True"):
            envcraft.make(corpus, name)
        with pytest.raises(Untrusted) as refused:
            envcraft.make_vec(["ant", name], corpus=corpus)
        assert "--" not in str(refused.value)
        assert re.search("--sandbox auto runs it .* and --trust runs it", refused.value.in_a_command)
        assert not (corpus.parent / "imported").exists()
        envcraft.make(corpus, name, trust=True)
        assert (corpus.parent / "imported").exists()

    def test_a_verdict_is_on_one_source_and_one_contract(self, corpus: Path) -> None:
        with pytest.raises(Untrusted, match=r"no verdict under the contract gymnasium.* --contract gymnasium`"):
            envcraft.make(corpus, "ant", contract="gymnasium")
        with Store(corpus, write=True) as store:
            store.add("ant.py", game("Ant", "self.steps >= 6").encode())
        with pytest.raises(Untrusted, match=r"ant\.py has no verdict"):
            envcraft.make(corpus, "ant")

    def test_a_verdict_on_other_promises_of_the_same_name_is_none(self, corpus: Path) -> None:
        with Store(corpus, write=True) as store:
            store.db.execute("UPDATE settings SET contract_sha256 = ? WHERE contract = 'arcade'", ("0" * 64,))
        with pytest.raises(Untrusted, match="no verdict under the contract arcade"):
            envcraft.make(corpus, "ant")

    def test_the_last_verdict_counts(self, corpus: Path) -> None:
        text = game("Ant", "self.steps >= 5")
        with Store(corpus, write=True) as store:
            judged(store, "ant.py", text, "Ant", ARCADE, Verdict.FAIL, "newer rules")
        with pytest.raises(Untrusted, match="has the verdict fail"):
            envcraft.make(corpus, "ant")
        with Store(corpus, write=True) as store:
            # One that could not be judged says nothing, neither against an earlier fail nor against an earlier pass.
            judged(store, "ant.py", text, "Ant", ARCADE, Verdict.ERROR, "newest rules")
            judged(store, "bee.py", game("Bee", "self.steps >= 7"), "Bee", ARCADE, Verdict.ERROR, "newest rules")
        with pytest.raises(Untrusted, match="has the verdict fail"):
            envcraft.make(corpus, "ant")
        envcraft.make(corpus, "bee")

    def test_pass_of_some_checks_is_not_trusted(self, corpus: Path, tmp_path: Path) -> None:
        new, failed, ant = _texts(corpus, "new.py", "failed.py", "ant.py")
        with Store(corpus, write=True) as store:
            judged(store, "new.py", new, "New", ARCADE, Verdict.PASS, "fewer rules", checks="source")
            judged(store, "failed.py", failed, "Failed", ARCADE, Verdict.PASS, "fewer rules", checks="source")
            names = [one.name for one in Order(store, tmp_path).environments()]
            assert not {"new.py", "failed.py"} & set(names)
        with pytest.raises(Untrusted, match=r"new\.py has passed only some of the checks under"):
            envcraft.make(corpus, "new")
        with pytest.raises(Untrusted, match=r"failed\.py has the verdict fail under"):
            envcraft.make(corpus, "failed")
        assert not (corpus.parent / "imported").exists()
        with Store(corpus, write=True) as store:
            judged(store, "new.py", new, "New", ARCADE, Verdict.PASS, "later rules")
            assert [one.name for one in Order(store, tmp_path).environments()].count("new.py") == 1
            # Nor does it take back what all have found.
            judged(store, "ant.py", ant, "Ant", ARCADE, Verdict.PASS, "fewer rules", checks="source")
        envcraft.make(corpus, "new")
        envcraft.make(corpus, "ant")

    def test_another_budget_takes_no_finding_back(self, corpus: Path, tmp_path: Path) -> None:
        (text,) = _texts(corpus, "ant.py")
        with Store(corpus, write=True) as store:
            judged(store, "ant.py", text, "Ant", ARCADE, Verdict.FAIL, budget="standard")
            judged(store, "ant.py", text, "Ant", ARCADE, Verdict.PASS)
            names = [one.name for one in Order(store, tmp_path).environments()]
            assert "bee.py" in names
            assert "ant.py" not in names
        with pytest.raises(Untrusted, match="failed the same checks with another budget or seed"):
            envcraft.make(corpus, "ant")

    @pytest.mark.parametrize("same", [True, False])
    def test_pass_of_all_checks_does_not_revoke_failure_of_some(self, corpus: Path, tmp_path: Path, same: bool) -> None:
        (text,) = _texts(corpus, "ant.py")
        with Store(corpus, write=True) as store:
            offered = "rules" if same else "older rules"
            judged(store, "ant.py", text, "Ant", ARCADE, Verdict.FAIL, "some", checks="api,source", offered=offered)
            judged(store, "ant.py", text, "Ant", ARCADE, Verdict.PASS)
            assert ("ant.py" in [one.name for one in Order(store, tmp_path).environments()]) is not same
        if same:
            with pytest.raises(Untrusted, match="or some of them alone"):
                envcraft.make(corpus, "ant")
        else:
            envcraft.make(corpus, "ant")

    def test_unknown_checks_become_known_with_the_next_run(self, corpus: Path) -> None:
        with Store(corpus, write=True) as store:
            store.db.execute("UPDATE settings SET checks = '?'")
        with pytest.raises(Untrusted, match="has passed unknown checks"):
            envcraft.make(corpus, "ant")
        with Store(corpus, write=True) as store:
            for other in ("?", ""):
                store.settings(
                    Settings("arcade", contract_digest(ARCADE), "rules", 0, "quick", "process", "python 3", other)
                )
                assert store.db.execute("SELECT checks FROM settings WHERE contract = 'arcade'").fetchall() == [
                    (other,)
                ]
        envcraft.make(corpus, "ant")

    def test_a_file_is_trusted_by_the_audit_of_a_folder_above(self, tmp_path: Path) -> None:
        (tmp_path / "deep").mkdir()
        file = tmp_path / "deep" / "game.py"
        file.write_text(game())
        with pytest.raises(Untrusted, match=f"`envcraft validate {file}` judges it"):
            envcraft.make(file)
        with Store.create(tmp_path / ".envcraft", folder=True) as store:
            judged(store, "deep/game.py", game(), "Game", ARCADE, Verdict.PASS)
        envcraft.make(file)
        file.write_text(game("Game", "self.steps >= 8"))
        with pytest.raises(Untrusted, match=f"`envcraft audit {tmp_path}`"):
            envcraft.make(file)
        with Store(tmp_path / ".envcraft", write=True) as store:
            judged(store, "deep/game.py", file.read_text(), "Game", ARCADE, Verdict.FAIL)
        with pytest.raises(Untrusted, match=f"`envcraft corpus show {tmp_path} deep/game.py` says why"):
            envcraft.make(file)


class TestUsageErrors:
    def test_names_that_do_not_exist(self, corpus: Path, tmp_path: Path) -> None:
        with pytest.raises(UsageError, match="`envcraft corpus list"):
            envcraft.make(corpus, "eel")
        with pytest.raises(UsageError, match=r"several environments: name one, such as ant\.py"):
            envcraft.make(corpus)
        with pytest.raises(UsageError, match=r"CartPole-v1 is an id; .* gymnasium\.make makes"):
            envcraft.make("CartPole-v1")
        with pytest.raises(UsageError, match="is not a corpus"):
            envcraft.make(tmp_path / "nothing", "ant")
        with pytest.raises(UsageError, match="cannot be read"):
            envcraft.make(tmp_path / "nothing.py")
        with pytest.raises(UsageError, match="no contract 'arcad'; did you mean arcade"):
            envcraft.make(corpus, "ant", contract="arcad")

    def test_files_without_an_environment_and_with_one_that_raises(self, tmp_path: Path) -> None:
        file = tmp_path / "game.py"
        file.write_text("import gymnasium\nraise RuntimeError('too early')\n")
        with pytest.raises(EnvironmentFailed, match="cannot be imported: RuntimeError: too early"):
            envcraft.make(file, trust=True)
        file.write_text("import gymnasium\n")
        with pytest.raises(UsageError, match="has no environment class"):
            envcraft.make(file, trust=True)
        file.write_text(game("One") + game("Two"))
        with pytest.raises(UsageError, match="classes One, Two"):
            envcraft.make(file, trust=True)

    def test_arguments_reach_the_constructor(self, corpus: Path) -> None:
        env = envcraft.make(corpus, "ant", start=4)
        env.reset(seed=0)
        assert env.step(np.array([0, 0, 0]))[2]
        with pytest.raises(EnvironmentFailed, match="unexpected keyword argument 'begin'"):
            envcraft.make(corpus, "ant", begin=4)
        assert envcraft.make(corpus, "ant", render_mode=None).render_mode == "rgb_array"


class TestLoading:
    def test_a_source_that_changed_is_not_run(self, corpus: Path) -> None:
        found = resolve(corpus, "ant")
        Path(found.path).write_text("raise SystemExit\n")
        with pytest.raises(CorpusDamaged, match="has changed"):
            envcraft.make(corpus, "ant")
        with pytest.raises(UsageError, match="has changed since it was looked up"):
            loading.load(found.path, Path(found.path).read_bytes(), found.sha256)

    def test_bytecode_beside_a_source_is_not_run(self, corpus: Path) -> None:
        found = resolve(corpus, "cat")
        cached = Path(bootstrap.cache_from_source(found.path))
        cached.parent.mkdir()
        cached.write_bytes(
            bootstrap._code_to_hash_pyc(  # type: ignore[attr-defined]
                compile("raise SystemExit", found.path, "exec"), b"0" * 8, False
            )
        )
        envcraft.make(corpus, "cat").reset()
        assert sys.modules[f"envcraft_source_{found.sha256}"].__file__ == found.path

    def test_a_module_that_failed_is_tried_again(self, tmp_path: Path) -> None:
        flag = tmp_path / "flag"
        text = f"import pathlib\nif not pathlib.Path({str(flag)!r}).exists():\n    raise OSError\n"
        digest = hashlib.sha256(text.encode()).hexdigest()
        with pytest.raises(OSError):  # noqa: PT011
            loading.load("x.py", text.encode(), digest)
        flag.touch()
        loading.load("x.py", text.encode(), digest)


class TestSameAsJudged:
    """An episode of ``arcade-native`` as the sandbox records it, and the same episode of what ``make`` gives."""

    def test_observations_rewards_and_flags_are_the_same_bits(self, corpus: Path) -> None:
        actions = np.random.default_rng(0).integers(0, [5, 2, 2], (40, 3)).tolist()
        found = resolve(corpus, "native")
        target = Target("native.py", found.source)
        with Subject(target, ARCADE_NATIVE, WorkerPool(driver_named("process")).lease(), BUDGETS["quick"]) as subject:
            trace = subject.rollout(Rollout(7, actions, keep=len(actions) + 1))
        env = envcraft.make(corpus, "native")
        observation, info = env.reset(seed=7)
        inner: Any = env.unwrapped
        frames, raw, rewards, flags = [observation], [inner.render()], [], []
        for action in actions:
            observation, reward, terminated, truncated, info = env.step(np.array(action))
            frames.append(observation)
            raw.append(inner.render())
            rewards.append(reward)
            flags.append((terminated, truncated))
        assert np.array_equal(trace.frames, frames)
        # What is not looked at is compared as the environment returned it.
        layout = ValueCodec({"k": "array", "dtype": "|u1", "shape": list(raw[0].shape)})
        assert trace.observations == [xxhash.xxh3_128_digest(frame.tobytes(), layout.tag) for frame in raw]
        assert trace.rewards == rewards
        assert list(zip(trace.terminated, trace.truncated, strict=True)) == flags
        assert trace.info()["score"] == info["score"]
        rendered: Any = env.render()
        assert np.array_equal(rendered, observation)

    def test_the_step_limit_is_the_contracts(self, corpus: Path) -> None:
        env = envcraft.make(corpus, "native")
        assert isinstance(env, StepLimit)
        assert env._limit == 1000
