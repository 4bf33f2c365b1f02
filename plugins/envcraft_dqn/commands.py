"""The commands ``envcraft train`` and ``envcraft evaluate``. Importing this module does not import torch."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from envcraft.cli import completion
from envcraft.cli.signals import uninterrupted
from envcraft.errors import UsageError
from envcraft.files import UNFINISHED, refuse_file
from envcraft.text import one_line, plural
from envcraft_dqn.config import read_config, write_config
from envcraft_dqn.files import exclusive
from envcraft_dqn.settings import AUGMENTATIONS, HEADS, OBJECTIVES, PRECISIONS, RENAMED, REPLAYS, SIZES, Settings

_F = TypeVar("_F", bound=Callable[..., Any])
_DEFAULT = Settings()
#: The first file of a run, which every folder of a run holds.
_CONFIG = "config.toml"


def _environment_options(command: _F) -> _F:
    """Options that select environments and where their code runs."""
    for option in reversed(
        (
            click.option(
                "--select",
                multiple=True,
                metavar="PATTERN",
                help="Select environments by name, such as snake, or by pattern, such as 'tetris_*'.",
            ),
            click.option(
                "--contract",
                metavar="NAME",
                shell_complete=completion.contracts,
                help="Contract of the environments.  [default: the contract that they passed]",
            ),
            click.option("--trust", is_flag=True, help="Run environments in this process even if they did not pass."),
            click.option(
                "--sandbox",
                metavar="NAME",
                shell_complete=completion.sandboxes,
                help="Run the environments in this sandbox.",
            ),
            click.option("--workers", type=click.IntRange(0, 64), help="Number of processes.  [default: one per core]"),
            click.option(
                "--fast/--no-fast",
                default=None,
                help="Use the simulator of the environments' family instead of their code.  [default: if possible]",
            ),
            click.option(
                "--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Random seed."
            ),
            click.option(
                "--device", default="auto", show_default=True, metavar="NAME", help="Torch device, such as cpu or cuda."
            ),
        )
    ):
        command = option(command)
    return command


def _number(name: str, text: str, minimum: float = 1) -> Callable[[_F], _F]:
    """An option for the numeric setting with this attribute name."""
    default = getattr(_DEFAULT, name)
    kind = click.IntRange(int(minimum)) if isinstance(default, int) else click.FloatRange(minimum)
    option = RENAMED.get(name, name).replace("_", "-")
    return click.option(f"--{option}", name, type=kind, default=default, show_default=True, help=text)


@click.command()
@click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
@click.option("--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="Folder of the run.")
@click.option(
    "--config",
    metavar="FILE",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    is_eager=True,
    expose_value=False,
    callback=read_config,
    help="TOML file with options, such as DIR/config.toml of a run. Options on the command line take precedence.",
)
@click.option("--eval-every", type=click.IntRange(1), help="Updates between two tests in held-out environments.")
@click.option(
    "--held-out",
    multiple=True,
    metavar="PATTERN",
    help="Names of environments for these tests, which are left out of the training.",
)
@click.option(
    "--eval-episodes",
    type=click.IntRange(2),
    default=10,
    show_default=True,
    help="Episodes of each environment in these tests.",
)
@_environment_options
@click.option(
    "--size", type=click.Choice(list(SIZES)), default=_DEFAULT.size, show_default=True, help="Size of the network."
)
@click.option(
    "--head", type=click.Choice(HEADS), default=_DEFAULT.head, show_default=True, help="Output head of the network."
)
@click.option(
    "--objective",
    type=click.Choice(OBJECTIVES),
    default=_DEFAULT.objective,
    show_default=True,
    help="Q-learning, behaviour cloning, dataset aggregation, or Q-learning from demonstrations.",
)
@_number("margin", "Margin between a labelled action and others, for the objective dqfd.", 0.0)
@click.option(
    "--balanced/--no-balanced",
    default=_DEFAULT.balanced,
    show_default=True,
    help="Give rare actions more weight in the loss of labelled actions.",
)
@_number("temperature", "Temperature at which an agent that only imitates draws actions; 0 is greedy.", 0.0)
@click.option(
    "--augment",
    type=click.Choice(AUGMENTATIONS),
    default=_DEFAULT.augment,
    show_default=True,
    help="Random changes to frames in updates.",
)
@_number("lead", "Share of training episodes that follow the simulator's advice, for the objective dagger.", 0.0)
@click.option(
    "--initial",
    metavar="AGENT",
    type=click.Path(path_type=Path, exists=True),
    help="Agent, or folder of a run, whose weights the network starts with.",
)
@_number("steps", "Environment steps, summed over all environments.", 0)
@_number("pretrain_updates", "Updates on demonstrations alone, before online training.", 0)
@click.option(
    "--demos",
    metavar="PLAYER|CORPUS[:PLAYER]",
    shell_complete=completion.folders,
    help="Player of the demonstrations: random, noop, checkpoint:PATH, a player of `envcraft demos`, or its recordings "
    "in a corpus.",
)
@_number("demonstrations", "Demonstrated steps in each environment.")
@_number("num_envs", "Number of environments to step in parallel.")
@_number("cycle", "Steps of an environment before another takes its turn.")
@_number("segment", "Steps of an environment between two possible checkpoints.")
@_number("batch", "Transitions in an update.")
@_number("learning_rate", "Learning rate of Adam.", 0.0)
@click.option("--decay", is_flag=True, help="Let the learning rate fall linearly to zero.")
@_number("gamma", "Discount factor.", 0.0)
@_number("n_step", "Length of n-step returns.")
@_number("train_every", "Steps per update.")
@_number("target_every", "Updates between two copies to the target network.")
@_number("epsilon_first", "Initial rate of random actions.", 0.0)
@_number("epsilon_last", "Final rate of random actions.", 0.0)
@_number("epsilon_share", "Share of the steps in which the rate of random actions falls.", 0.0)
@_number("alpha", "Exponent of the priorities.", 0.0)
@_number("beta", "Initial exponent of the importance-sampling weights, which rises to 1.", 0.0)
@click.option(
    "--value-rescaling/--no-value-rescaling",
    default=_DEFAULT.value_rescaling,
    show_default=True,
    help="Learn values on a compressed scale, for environments with large and with small rewards.",
)
@_number("capacity", "Capacity of the replay buffer, in transitions.")
@_number("starts", "Steps before the first update, without pretraining.", 0)
@click.option(
    "--demonstration-share",
    type=click.FloatRange(0, 1),
    help="Share of demonstrations in online batches.  [default: by priority]",
)
@click.option(
    "--replay", type=click.Choice(REPLAYS), default=_DEFAULT.replay, show_default=True, help="Storage of frames."
)
@click.option(
    "--precision",
    type=click.Choice(PRECISIONS),
    default=_DEFAULT.precision,
    show_default=True,
    help="Floating-point precision of the network.",
)
@click.option("--compiled", is_flag=True, help="Compile the loss with torch.compile.")
@click.option(
    "--checkpoint-minutes",
    type=click.FloatRange(0),
    default=5.0,
    show_default=True,
    help="Approximate minutes between two checkpoints.",
)
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
    initial: Path | None,
    eval_every: int | None,
    held_out: tuple[str, ...],
    eval_episodes: int,
    checkpoint_minutes: float,
    **options: Any,
) -> None:
    """Train one agent on the frames of many environments.

    The same command resumes an interrupted run from its last checkpoint, and with more --steps it continues a
    completed run. The agent is DIR/agent.safetensors.
    """
    settings = Settings(**options)
    settings.check()
    if bool(held_out) != (eval_every is not None):
        raise UsageError("--eval-every and --held-out belong together: name the environments of the tests")
    _check_output(output)
    from envcraft_dqn.selection import matches, select_environments, source_digests

    selection = select_environments(corpus, select, contract, trust, sandbox, workers, fast)
    with uninterrupted():
        _require_libraries("training")
        from envcraft_dqn.callbacks import ProgressLogger
        from envcraft_dqn.demo_sources import adviser_named, source_named
        from envcraft_dqn.held_out import HeldOut
        from envcraft_dqn.policies import agent_file
        from envcraft_dqn.trainer import train as run
    tested = [name for name in selection.names if matches(name, held_out)]
    names = [name for name in selection.names if name not in tested]
    if held_out and not (tested and names):
        count = f"{len(tested)} of {len(selection.names)} environments"
        raise UsageError(f"--held-out {' '.join(held_out)} matches {count}; it must match some, but not all")
    selection = dataclasses.replace(selection, names=names)
    test = None
    if eval_every is not None:
        test = HeldOut(tested, selection.open_vector, output, eval_every, eval_episodes, settings.seed)
    _ensure_writable(output)
    # From here on the folder is that of a run, so that the same command goes on after an interruption.
    write_config(output / _CONFIG)
    source = None if demos is None else source_named(demos, selection, settings, output)
    adviser = adviser_named(demos, selection) if demos is not None and settings.objective == "dagger" else None
    first = None if initial is None else agent_file(initial)
    click.echo(f"{plural(len(names), 'environment')}; output in {output}", err=True)
    every, sources = checkpoint_minutes * 60, source_digests(corpus, names, contract)
    try:
        with exclusive(output), ProgressLogger(output / "tensorboard") as callback:
            agent = run(
                settings, names, selection.open_vector, output, source, callback, every, sources, adviser, first, test
            )
    except KeyboardInterrupt:
        resumable = (output / "checkpoint" / "state.json").is_file()
        effect = "resumes from the last checkpoint" if resumable else "starts over, because there is no checkpoint yet"
        click.echo(f"the same command {effect}", err=True)
        raise
    click.echo(agent)


@click.command()
@click.argument("target", metavar="CORPUS|FILE", type=click.Path(path_type=Path))
@click.option(
    "--player",
    required=True,
    metavar="NAME",
    help="Player: random, noop, checkpoint:PATH, or a player of `envcraft demos`, which plays in a sandbox.",
)
@click.option(
    "--episodes", type=click.IntRange(2), default=1000, show_default=True, help="Episodes of each environment."
)
@click.option(
    "--lanes",
    "num_envs",
    type=click.IntRange(1),
    default=64,
    show_default=True,
    help="Number of environments to step in parallel.",
)
@click.option(
    "--epsilon",
    type=click.FloatRange(0, 1),
    default=0.0,
    show_default=True,
    help="Rate of random actions of a checkpoint.",
)
@click.option("--output", metavar="FILE", type=click.Path(path_type=Path), help="Also write the JSON to this file.")
@click.option(
    "--gif",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Also write an episode of the first environment as an animated GIF.",
)
@_environment_options
def evaluate(
    target: Path,
    player: str,
    episodes: int,
    num_envs: int,
    epsilon: float,
    output: Path | None,
    gif: Path | None,
    select: tuple[str, ...],
    contract: str | None,
    trust: bool,
    sandbox: str | None,
    workers: int | None,
    fast: bool | None,
    seed: int,
    device: str,
) -> None:
    """Play whole episodes; print mean returns and lengths as JSON.

    The JSON has the means of each environment, with standard errors and 95% confidence intervals.
    """
    import json

    from envcraft_dqn import privileged
    from envcraft_dqn.selection import select_environments

    privileged_player = privileged.players().get(player)
    if privileged_player is not None:
        # The code of such a player runs beside that of the environment, so it needs the sandbox too.
        sandbox = sandbox or "auto"
    selection = select_environments(target, select, contract, trust, sandbox, workers, fast)
    if output is not None:
        _ensure_writable(output.parent)
    with uninterrupted():
        _require_libraries("evaluation")
        from envcraft_dqn.env_spec import EnvSpec
        from envcraft_dqn.evaluation import evaluate as play
        from envcraft_dqn.evaluation import write_episode
        from envcraft_dqn.policies import policy_named
    if gif is not None and privileged_player is not None:
        raise UsageError("--gif shows policies on frames; `envcraft demos --cache` has the frames of other players")
    if privileged_player is not None:
        results = [one.summary() for one in privileged.evaluate(privileged_player, selection, episodes, seed)]
    else:
        names, open_vector = selection.names, selection.open_vector
        policy = policy_named(player, EnvSpec.of(open_vector, names[0]), seed, epsilon, device)
        if gif is not None:
            write_episode(gif, names[0], open_vector, policy, seed)
        playing = play(names, open_vector, policy, episodes, num_envs, seed)
        with click.progressbar(playing, length=len(names), label="environments", file=sys.stderr) as played:
            results = [one.summary() for one in played]
    report = {
        "format": 1,
        "target": str(target),
        "player": player,
        "epsilon": epsilon,
        "seed": seed,
        "environments": results,
    }
    text = json.dumps(report, indent=1)
    click.echo(text)
    if output is not None:
        try:
            output.write_text(f"{text}\n", "utf-8")
        except OSError as error:
            raise UsageError(f"{output} cannot be written: {error.strerror or error}") from None


def _check_output(folder: Path) -> None:
    """Raise UsageError if a folder is neither new nor empty nor that of a run."""
    if not folder.is_dir() or (folder / _CONFIG).is_file():
        return
    names = [entry.name for entry in folder.iterdir() if not entry.name.startswith(UNFINISHED)]
    if foreign := min(names, default=""):
        words = f"{folder} contains {one_line(foreign)} and is not a run; name a folder that is new, empty or a run"
        raise UsageError(words, setting="output")


def _ensure_writable(folder: Path) -> None:
    """Create a folder, and check before long work that files can be written to it. Raises UsageError."""
    refuse_file(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"{folder} cannot be written to: {error.strerror or error}") from None


def _require_libraries(use: str) -> None:
    """Raises UsageError without the libraries of the extra ``train``, which a use needs."""
    for name in ("numba", "safetensors", "tensorboard", "torch", "zstandard"):
        if importlib.util.find_spec(name) is None:
            raise UsageError(f"{use} needs {name}; install it with `pip install 'envcraft-rl[train]'`")
