"""Audits of folders whose environments import files beside them: the same verdicts as ``envcraft validate`` gives."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

import envcraft
from envcraft.corpus import tasks
from envcraft.corpus.audit import stored_targets
from envcraft.corpus.store import Store, environments
from envcraft.environments.sources import Untrusted, resolve
from envcraft.model.project import with_project
from envcraft.model.target import read_target

from .conftest import Invoke

GRID = """import gymnasium as gym

from sizes import SIZE


class Grid(gym.Env):
    observation_space = gym.spaces.Discrete(SIZE)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = int(self.np_random.integers(SIZE - 2))
        self.steps = 0
        return self.at, {}

    def step(self, action):
        self.at = min(max(self.at + 2 * int(action) - 1, 0), SIZE - 1)
        self.steps += 1
        won = self.at == SIZE - 1
        return self.at, float(won), won, self.steps >= 40, {}
"""
OPTIONS = ("--contract", "gymnasium", "--sandbox", "process", "--budget", "quick")
SOURCE = (*OPTIONS, "--checks", "source")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "grid.py").write_text(GRID)
    (folder / "sizes.py").write_text("SIZE = 6\n")
    return folder


def test_an_audit_judges_with_the_files_of_the_project(project: Path, invoke: Invoke) -> None:
    validated = json.loads(invoke("validate", "project", *OPTIONS, "--format", "json").stdout)["reports"][0]
    result = invoke("audit", "project", *OPTIONS, "--format", "json")
    assert result.exit_code == 0, result.output
    [audited] = json.loads(result.stdout)["reports"]
    for field in ("path", "verdict", "source_sha256", "traces", "project", "steps"):
        assert audited[field] == validated[field], field
    assert set(audited["project"]["files"]) == {"sizes.py"}

    # It runs in a sandbox with these files, and not in this process, which would import what nobody has judged.
    for source in (resolve("project", "grid"), resolve("project/grid.py")):
        with pytest.raises(Untrusted, match=r"imports files of its project.*sandbox='auto'"):
            source.ensure_trusted()
    for arguments in (("project", "grid"), ("project/grid.py",)):
        env = envcraft.make(*arguments, sandbox="process")
        assert env.reset(seed=0)[0] in range(6)
        env.close()

    # A corpus holds single files, so an export would not run.
    nothing = invoke("export", "project", "--to", "package", "--output", "out", "--name", "mine")
    assert nothing.exit_code == 2
    assert "need other files of their projects" in nothing.stderr
    (project / "alone.py").write_text(GRID.replace("from sizes import SIZE", "SIZE = 6"))
    invoke("audit", "project", *OPTIONS)
    exported = invoke("export", "project", "--to", "package", "--output", "out", "--name", "mine")
    assert exported.exit_code == 0, exported.output
    assert "left out 1 environment that needs other files of its project" in exported.stderr
    assert not (Path("out") / "mine" / "sources" / "grid.py").exists()


@pytest.mark.parametrize("option", [(), ("--changed",), ("--only-failed",)])
def test_a_change_of_a_file_of_the_project_counts(project: Path, invoke: Invoke, option: tuple[str, ...]) -> None:
    assert "1 judged now, 0 known" in invoke("audit", "project", *SOURCE).stdout
    assert "0 judged now, 1 known" in invoke("audit", "project", *SOURCE).stdout
    (project / "sizes.py").write_text("SIZES = 6\n")
    failed = invoke("audit", "project", *SOURCE, "--changed")
    assert failed.exit_code == 1
    assert "1 judged now" in failed.stdout
    assert "EC003" in failed.stdout
    (project / "sizes.py").write_text("SIZE = 7\n")
    assert "1 judged now" in (again := invoke("audit", "project", *SOURCE, *option)).stdout
    assert again.exit_code == 0
    (project / "sizes.py").unlink()
    assert "EC002" in invoke("audit", "project", *SOURCE).stdout


def test_a_contract_for_single_files_leaves_the_project_out(project: Path, invoke: Invoke) -> None:
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source")
    first = invoke("audit", "project", *options)
    assert "EC002" in first.stdout
    assert "0 judged now, 1 known" in invoke("audit", "project", *options).stdout


@pytest.mark.parametrize("sizes", ["SIZE = 9\n", ""])
def test_one_text_with_different_files_has_no_one_verdict(project: Path, invoke: Invoke, sizes: str) -> None:
    (project / "other").mkdir()
    (project / "other" / "grid.py").write_text(GRID)
    if sizes:
        (project / "other" / "sizes.py").write_text(sizes)
    result = invoke("audit", "project", *SOURCE)
    assert result.exit_code == 2
    assert "grid.py and other/grid.py have the same text and import different files" in result.stderr
    (project / "other" / "grid.py").write_text(f"# other\n{GRID}")
    assert "2 judged now" in invoke("audit", "project", *SOURCE).stdout


def test_tasks_and_other_readers_have_the_files(project: Path, invoke: Invoke) -> None:
    invoke("audit", "project", *SOURCE)
    with Store(project / ".envcraft") as store:
        [target] = stored_targets(store, environments.every(store))
    assert target.path == "grid.py"
    assert target.project is not None
    assert target.project.files == {"sizes.py": b"SIZE = 6\n"}
    task = msgspec.msgpack.decode(tasks.encode(b"", target), type=tasks.Task)
    assert task.project == target.project == with_project(read_target("project/grid.py")).project


def test_a_record_is_judged_again_with_the_files(project: Path, invoke: Invoke) -> None:
    invoke("audit", "project", *SOURCE)
    assert invoke("corpus", "records", "project", "--output", "project/records.jsonl").exit_code == 0
    [record] = map(json.loads, (project / "records.jsonl").read_text().splitlines())
    assert record["verdict"] == "pass"
    for place in ("project", "project/records.jsonl"):
        again = invoke("reverify", place, "--sandbox", "process")
        assert "1 as recorded, 0 drifted" in again.stdout, again.output


def test_a_corpus_says_that_it_holds_single_files(project: Path, invoke: Invoke) -> None:
    invoke("corpus", "init", "corpus")
    added = invoke("corpus", "add", "corpus", "project")
    assert "1 environment added" in added.stdout
    assert "1 of them needs other files of its project, which a corpus does not hold" in added.stderr
