"""``envcraft train`` and ``envcraft evaluate``. Importing this imports no torch."""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from envcraft.cli import uninterrupted
from envcraft.errors import UsageError
from envcraft_dqn.lock import alone
from envcraft_dqn.settings import HEADS, PRECISIONS, REPLAYS, SIZES, Settings

_F = TypeVar("_F", bound=Callable[..., Any])
_DEFAULT = Settings()


def _where(command: _F) -> _F:
    """Which environments, and where their code runs."""
    for option in reversed(
        (
            click.option(
                "--select", multiple=True, metavar="PATTERN", help="Environments whose names fit, such as 'tetris_*'."
            ),
            click.option("--contract", metavar="NAME", help="What they promise  [default: what they have passed]"),
            click.option("--trust", is_flag=True, help="Run also what has not passed in this process."),
            click.option("--sandbox", metavar="NAME", help="Run them in a sandbox, whatever was judged of them."),
            click.option("--workers", type=click.IntRange(0, 64), help="Processes  [default: one a core]"),
            click.option(
                "--fast/--no-fast",
                default=None,
                help="By the program of the family that wrote them, running none of their code  [default: if it can]",
            ),
            click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True),
            click.option("--device", default="auto", show_default=True, metavar="NAME", help="Such as cpu or cuda."),
        )
    ):
        command = option(command)
    return command


def _number(name: str, words: str, least: float = 1) -> Callable[[_F], _F]:
    """An option for the setting of this name."""
    default = getattr(_DEFAULT, name)
    kind = click.IntRange(int(least)) if isinstance(default, int) else click.FloatRange(least)
    return click.option(f"--{name.replace('_', '-')}", type=kind, default=default, show_default=True, help=words)


@click.command()
@click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
@click.option("--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="Where the run is kept.")
@_where
@click.option("--size", type=click.Choice(list(SIZES)), default=_DEFAULT.size, show_default=True)
@click.option("--head", type=click.Choice(HEADS), default=_DEFAULT.head, show_default=True)
@_number("steps", "Environment steps, over all environments.", 0)
@_number("pretrain_updates", "Updates on demonstrations alone, before.", 0)
@click.option(
    "--demos",
    metavar="PLAYER|CORPUS[:PLAYER]",
    help="Whose demonstrations: random, noop, checkpoint:PATH, a player that `envcraft demos` has, or what it recorded "
    "in a corpus.",
)
@_number("demonstrations", "Steps of them from each environment.")
@_number("lanes", "Environments side by side.")
@_number("cycle", "Steps of an environment before the next one's turn.")
@_number("leg", "Steps before episodes are begun anew, and a checkpoint can be taken.")
@_number("batch", "Transitions an update.")
@_number("learning_rate", "Of Adam.", 0.0)
@_number("gamma", "What a reward is worth a step later.", 0.0)
@_number("n_step", "Steps of a return.")
@_number("train_every", "Steps for each update.")
@_number("target_every", "Updates before the target network is brought up to date.")
@_number("epsilon_first", "Random actions at first.", 0.0)
@_number("epsilon_last", "And in the end.", 0.0)
@_number("epsilon_share", "Share of the steps in which they become fewer.", 0.0)
@_number("capacity", "Slots of the replay.")
@_number("starts", "Steps before the first update, without pretraining.", 0)
@click.option(
    "--demonstration-share",
    type=click.FloatRange(0, 1),
    help="Of the draws online; importance weights take it back as beta rises  [default: as priorities have it]",
)
@click.option("--replay", type=click.Choice(REPLAYS), default=_DEFAULT.replay, show_default=True)
@click.option("--precision", type=click.Choice(PRECISIONS), default=_DEFAULT.precision, show_default=True)
@click.option("--compiled", is_flag=True, help="Compile the loss by torch.compile.")
@click.option("--checkpoint-minutes", type=click.FloatRange(0), default=5.0, show_default=True)
def train(
    corpus: Path,
    output: Path,
    select: tuple[str, ...],
    contract: str | None,
    trust: bool,
    sandbox: str | None,
    workers: int | None,
    fast: bool | None,
    demos: str | None,
    checkpoint_minutes: float,
    **given: Any,
) -> None:
    """Train one agent on the environments of a corpus, by their frames.

    The same command goes on with a run that was ended, from its last checkpoint. The agent is DIR/agent.safetensors.
    """
    settings = Settings(**given)
    settings.check()
    from envcraft_dqn.places import environments, sources

    names, open_vector = environments(corpus, select, contract, trust, sandbox, workers, fast)
    with uninterrupted():
        _needed()
        from envcraft_dqn.learner import train as run
        from envcraft_dqn.sources import Where, source_named
        from envcraft_dqn.telling import Shown
    there = Where(corpus, names, open_vector, contract, sandbox, workers)
    source = None if demos is None else source_named(demos, there, settings, output)
    _writable(output)
    click.echo(f"{len(names):,} environments; the run is kept in {output}", err=True)
    every, told = checkpoint_minutes * 60, sources(corpus, names, contract)
    try:
        with alone(output), Shown(output / "tensorboard") as teller:
            agent = run(settings, names, open_vector, output, source, teller, every, told)
    except KeyboardInterrupt:
        kept = (output / "checkpoint" / "state.json").is_file()
        again = "goes on from the last checkpoint" if kept else "begins anew, since there was no checkpoint yet"
        click.echo(f"the same command {again}", err=True)
        raise
    click.echo(agent)


@click.command()
@click.argument("target", metavar="CORPUS|FILE", type=click.Path(path_type=Path))
@click.option(
    "--player",
    required=True,
    metavar="NAME",
    help="random, noop, checkpoint:PATH, or one that `envcraft demos` has, which plays in a sandbox.",
)
@click.option("--episodes", type=click.IntRange(2), default=1000, show_default=True, help="Of each environment.")
@click.option("--lanes", type=click.IntRange(1), default=64, show_default=True, help="Episodes side by side.")
@click.option(
    "--epsilon", type=click.FloatRange(0, 1), default=0.0, show_default=True, help="Random actions of a checkpoint."
)
@click.option("--output", metavar="FILE", type=click.Path(path_type=Path), help="Where the JSON goes, too.")
@_where
def evaluate(
    target: Path,
    player: str,
    episodes: int,
    lanes: int,
    epsilon: float,
    output: Path | None,
    select: tuple[str, ...],
    contract: str | None,
    trust: bool,
    sandbox: str | None,
    workers: int | None,
    fast: bool | None,
    seed: int,
    device: str,
) -> None:
    """Play whole episodes, and give mean return and length of each environment as JSON, with their intervals."""
    import json

    from envcraft_dqn import privileged
    from envcraft_dqn.places import environments

    seeing = privileged.players().get(player)
    if seeing is not None:
        # Their own code runs beside the environment's: nowhere else than in a sandbox.
        sandbox = sandbox or "auto"
    names, open_vector = environments(target, select, contract, trust, sandbox, workers, fast)
    if output is not None:
        _writable(output.parent)
    with uninterrupted():
        _needed()
        from envcraft_dqn.evaluation import evaluate as play
        from envcraft_dqn.evaluation import player_named
        from envcraft_dqn.spaces import Surface
    if seeing is not None:
        found = privileged.evaluate(seeing, target, names, contract, episodes, seed, sandbox, workers or None)
        done = [one.told() for one in found]
    else:
        who = player_named(player, Surface.of(open_vector, names[0]), seed, epsilon, device)
        playing = play(names, open_vector, who, episodes, lanes, seed)
        with click.progressbar(playing, length=len(names), label="environments", file=sys.stderr) as played:
            done = [one.told() for one in played]
    told = {
        "format": 1,
        "target": str(target),
        "player": player,
        "epsilon": epsilon,
        "seed": seed,
        "environments": done,
    }
    text = json.dumps(told, indent=1)
    click.echo(text)
    if output is not None:
        try:
            output.write_text(f"{text}\n", "utf-8")
        except OSError as error:
            raise UsageError(f"{output} cannot be written: {error.strerror or error}") from None


def _writable(folder: Path) -> None:
    """Make a folder that is written to, before anything has taken time. Raises UsageError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"{folder} cannot be written to: {error.strerror or error}") from None


def _needed() -> None:
    """Raises UsageError without the libraries of the extra ``train``."""
    for name in ("numba", "safetensors", "tensorboard", "torch", "zstandard"):
        if importlib.util.find_spec(name) is None:
            raise UsageError(f"training needs {name}; install it with `pip install 'envcraft-rl[train]'`")
