"""Sources of episodes: simulators, players that see the state, and recordings."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner, Result
from envcraft_dqn.demonstrations import Episode
from envcraft_dqn.recordings import RecordedDemonstrations
from envcraft_dqn.selection import select_environments

import envcraft
from envcraft.cli.group import cli
from envcraft.contracts.builtin import ARCADE
from envcraft.corpus.store import Environment, Store, demonstrations, environments
from envcraft.demonstrations.store import cache_path, load, save
from envcraft.errors import UsageError
from envcraft.judging.settings import Settings, contract_digest
from envcraft.model.verdict import SubjectReport, Verdict

from .conftest import GAMES

COUNT = 3
FIRST = "tetris_0_0000.py"
SANDBOX = ("--sandbox", "process")
TRAIN = ("--size", "tiny", "--steps", "60", "--lanes", "2", "--leg", "20", "--capacity", "3000", "--device", "cpu")


def run(*arguments: Any) -> Result:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


@pytest.fixture
def games(tmp_path: Path) -> Path:
    """Variants of the family tetris without verdicts."""
    corpus = tmp_path / "games"
    done = run("generate", "--family", "tetris", "--count", COUNT, "--seed", 0, "--corpus", corpus)
    assert done.exit_code == 0, done.output
    return corpus


def outcome(result: Result) -> list[dict[str, Any]]:
    assert result.exit_code == 0, result.output
    found: list[dict[str, Any]] = json.loads(result.stdout)["environments"]
    return found


def test_simulator_replaces_code_of_environments(games: Path, tmp_path: Path) -> None:
    playing = ("evaluate", games, "--player", "random", "--episodes", "20")
    done = run(*playing)
    assert "the simulator of the family plays 3 environments" in done.stderr
    fast = outcome(done)
    assert outcome(run(*playing, "--no-fast", "--trust", "--workers", "0")) == fast
    assert len(fast) == COUNT
    refused = run(*playing, "--no-fast")
    assert refused.exit_code == 2
    assert "has no verdict" in refused.output
    agents = [tmp_path / name for name in ("fast", "files")]
    assert run("train", games, "--output", agents[0], *TRAIN).exit_code == 0
    assert run("train", games, "--output", agents[1], *TRAIN, "--no-fast", "--trust", "--workers", "0").exit_code == 0
    assert len({(folder / "agent.safetensors").read_bytes() for folder in agents}) == 1


def test_unsupported_environments_run_by_their_files_or_are_reported(games: Path) -> None:
    playing = ("evaluate", games, "--player", "random", "--episodes", "2")
    for arguments, words in (
        (("--fast", "--sandbox", "process"), "omit --sandbox or --fast"),
        (("--fast", "--contract", "arcade-native"), "the contract arcade-native has one"),
    ):
        result = run(*playing, *arguments)
        assert result.exit_code == 2
        assert words in result.output
    with Store(games, write=True) as store:
        store.add("catch.py", (GAMES / "catch.py").read_bytes())
    assert "fast=True needs environments that `envcraft generate` wrote" in run(*playing, "--fast").output
    # An edited source differs from what the family generates.
    with Store(games, write=True) as store:
        store.remove("catch.py")
        row = environments.get(store, FIRST)
        assert row is not None
        store.add(FIRST, store.source(row.environment.source) + b"\n# mine\n", origin=row.origin)
    assert "is not what this version of the family tetris writes" in run(*playing, "--fast").output
    assert "has no verdict" in run(*playing).output
    assert select_environments(games, ["*_0001.py"]).names == ["tetris_0_0001.py"]
    assert "is a file" in run("evaluate", GAMES / "catch.py", "--player", "noop", "--fast").output


def test_failed_environments_are_skipped(games: Path) -> None:
    with Store(games, write=True) as store:
        source = next(one.source for one in environments.every(store) if one.name == FIRST)
        given = Settings(ARCADE.name, contract_digest(ARCADE), "rules", 0, "quick", "process", "python 3", "")
        report = SubjectReport(FIRST, "", source, Verdict.FAIL, "process", 0.1, 10, [])
        store.record(Environment(FIRST, source, ""), store.settings(given), report)
    done = run("evaluate", games, "--player", "noop", "--episodes", "2")
    assert "skipped 1 of 3 environments, because they have not passed" in done.stderr
    assert FIRST not in [one["name"] for one in outcome(done)]
    assert "has the verdict fail" in run("evaluate", games, "--player", "noop", "--select", FIRST).output


def same(one: list[Episode], other: list[Episode]) -> bool:
    return len(one) == len(other) and all(
        mine.terminated == theirs.terminated
        and all((np.asarray(a) == np.asarray(b)).all() for a, b in zip(mine[:3], theirs[:3], strict=True))
        for mine, theirs in zip(one, other, strict=True)
    )


def test_recordings_are_replayed_or_read_from_the_cache(games: Path, tmp_path: Path) -> None:
    where = ("demos", games, "--steps", "90", "--player", "random", "--select", FIRST, *SANDBOX)
    assert run(*where).exit_code == 0
    open_vector = select_environments(games).open_vector
    source = RecordedDemonstrations(games, open_vector)
    assert source.identity([FIRST]).startswith("random, recordings ")
    assert source.identity([FIRST]) != source.identity([])
    assert source.names == [FIRST]
    played = list(source.episodes(FIRST))
    assert list(source.episodes("tetris_0_0001.py")) == []
    assert sum(len(one.actions) for one in played) == 90
    assert all(one.terminated for one in played[:-1])
    overwriting = partial(envcraft.make_vec, corpus=games, fast=True, copy=False)
    assert same(list(RecordedDemonstrations(games, overwriting).episodes(FIRST)), played)
    assert run(*where, "--cache").exit_code == 0
    assert same(list(source.episodes(FIRST)), played)
    with pytest.raises(UsageError, match="no recordings of tetris"):
        RecordedDemonstrations(games, open_vector, "tetris")
    # A recording does not replay in another game.
    with Store(games) as store:
        [(_, row)] = demonstrations.named(store)
        cache_path(store, row.file).unlink()
    with pytest.raises(UsageError, match=r"episode 0 of random in .* does not replay"):
        list(RecordedDemonstrations(games, lambda _: open_vector(["tetris_0_0002.py"])).episodes(FIRST))
    output = tmp_path / "run"
    result = run("train", games, "--output", output, *TRAIN, "--demos", games, "--pretrain-updates", "3")
    assert result.exit_code == 0, result.output
    assert "2 of 3 environments have no demonstrations" in result.stderr
    assert (
        f"1 of 3 environments have fewer than 1,000 steps of demonstrations, such as {FIRST} with 90" in result.stderr
    )
    assert run(*where[:5], "noop", *where[6:]).exit_code == 0
    result = run("train", games, "--output", output, *TRAIN, "--demos", games, "--pretrain-updates", "3")
    assert "has recordings of noop and random: name one, as in" in result.output
    again = ("--demos", f"{games}:random", "--pretrain-updates", "3")
    assert run("train", games, "--output", output, *TRAIN, *again).exit_code == 0


def test_recordings_of_several_versions_or_contracts_are_refused(games: Path, tmp_path: Path) -> None:
    where = ("demos", games, "--steps", "40", "--player", "random", "--select", FIRST, *SANDBOX)
    assert run(*where).exit_code == 0
    open_vector = select_environments(games).open_vector

    def record_again(**changed: str) -> None:
        with Store(games, write=True) as store:
            [(_, row), *_] = demonstrations.named(store)
            save(store, msgspec.structs.replace(load(store, row), **changed))

    record_again(contract="arcade-native", contract_sha256="b" * 64)
    train = ("train", games, "--output", tmp_path / "run", *TRAIN, "--select", FIRST, "--demos", games)
    assert run(*train).exit_code == 0
    with pytest.raises(UsageError, match=f"{FIRST} has recordings of several contracts in .*arcade-native b"):
        RecordedDemonstrations(games, open_vector)
    with pytest.raises(UsageError, match="under the contract of these environments, only under arcade and arcade-nat"):
        RecordedDemonstrations(games, open_vector, contracts={FIRST: "c" * 64})
    record_again(player_digest="another")
    mixed = run(*train)
    assert mixed.exit_code == 2
    assert "several versions of the player random" in " ".join(mixed.output.split())
    arcade = {FIRST: contract_digest(ARCADE)}
    chosen = RecordedDemonstrations(games, open_vector, contracts=arcade, player_digest="another")
    assert chosen.steps(FIRST) == 40


def test_privileged_players_run_in_a_sandbox(games: Path, tmp_path: Path) -> None:
    chosen = ("--select", FIRST, *SANDBOX)
    [found] = outcome(run("evaluate", games, "--player", "tetris", "--episodes", "2", *chosen))
    [chance] = outcome(run("evaluate", games, "--player", "random", "--episodes", "50", "--select", FIRST))
    assert found["length"]["mean"] > 2 * chance["length"]["mean"]
    output = tmp_path / "run"
    training = ("train", games, "--output", output, *TRAIN, "--select", FIRST, "--demonstrations", "150")
    demos = ("--demos", "tetris", "--pretrain-updates", "3")
    assert run(*training, *demos).exit_code == 0
    with Store(output / "demonstrations") as store:
        [(name, row)] = demonstrations.named(store)
        assert (name, row.player, row.steps) == (FIRST, "tetris", 150)
        recorded = store.db.execute("SELECT recorded FROM demonstrations").fetchall()
    assert run(*training, *demos).exit_code == 0
    with Store(output / "demonstrations") as store:
        assert store.db.execute("SELECT recorded FROM demonstrations").fetchall() == recorded
    stranger = run("evaluate", GAMES / "catch.py", "--player", "tetris", "--episodes", "2", *SANDBOX)
    assert stranger.exit_code == 2
    assert "tetris supports only the family tetris" in stranger.output
