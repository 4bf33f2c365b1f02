"""``envcraft study``. Importing this imports no torch."""

from __future__ import annotations

import contextlib
import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from envcraft.cli import uninterrupted
from envcraft.errors import UsageError

if TYPE_CHECKING:
    from envcraft.executors import ExecutorPlugin
    from envcraft_dqn.study.protocol import Protocol
    from envcraft_dqn.study.work import Result

_F = TypeVar("_F", bound=Callable[..., Any])
_NEEDED = ("matplotlib", "numba", "safetensors", "tensorboard", "torch", "zstandard")
_LOCAL = "local"
#: Options that override a number of the scale, by whose it is.
_OWN = ("variants", "folds", "episodes", "privileged_episodes", "seeds", "controls", "familiar", "threads", "seed")
_TRAINING = ("size", "steps", "pretrain_updates", "demonstrations", "learning_rate", "demonstration_share", "batch")


@click.group()
def study() -> None:
    """Experiments over a corpus, from the environments to a report."""


def _count(name: str, words: str, least: int = 1) -> Callable[[_F], _F]:
    """An option for a number of the scale."""
    return click.option(f"--{name}", type=click.IntRange(least), show_default="that of the scale", help=words)


@study.command()
@click.argument("corpus", metavar="[CORPUS]", required=False, type=click.Path(path_type=Path))
@click.option(
    "--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="Where all of it is kept."
)
@click.option(
    "--scale",
    type=click.Choice(["smoke", "laptop", "reference"]),
    default="laptop",
    show_default=True,
    help="How much.",
)
@click.option("--select", multiple=True, metavar="PATTERN", help="Environments whose names fit, such as 'tetris-*'.")
@_count("variants", "Environments that are written where no corpus is named.", 2)
@_count("folds", "Parts of the environments, each of which is held out once.", 2)
@_count("episodes", "Of each environment and player.", 2)
@_count("privileged-episodes", "Of the privileged player; 0 leaves it out.", 0)
@_count("seeds", "Agents that differ in their seed alone.")
@_count("controls", "Splits in which the controls are trained that need a training.", 0)
@_count("familiar", "Environments of its training that an agent is tested on, too.", 0)
@click.option(
    "--subset",
    "subsets",
    multiple=True,
    metavar="SIZE:SPLITS",
    help="Train on so many environments alone, too, in so many splits; may be given again.",
)
@click.option(
    "--metric",
    type=click.Choice(["auto", "length", "return"]),
    default="auto",
    show_default=True,
    help="Longer episodes, or more return.",
)
@click.option("--size", type=click.Choice(["tiny", "small", "reference"]), show_default="that of the scale")
@_count("steps", "Environment steps of each training.", 0)
@_count("pretrain-updates", "Updates on demonstrations alone, before.")
@_count("demonstrations", "Steps of them from each environment.")
@click.option("--learning-rate", type=click.FloatRange(0), show_default="that of the scale")
@click.option("--demonstration-share", type=click.FloatRange(0, 1), show_default="that of the scale")
@_count("batch", "Transitions an update.")
@_count("threads", "Of each task.")
@click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Of everything.")
@click.option("--device", default="auto", show_default=True, metavar="NAME", help="Such as cpu or cuda.")
@click.option("--sandbox", default="auto", show_default=True, metavar="NAME", help="Where the privileged player plays.")
@click.option(
    "--executor", default=_LOCAL, show_default=True, metavar="NAME", help="Who does the tasks: local or dask."
)
@click.option("--scheduler", metavar="ADDRESS", help="Of the cluster of --executor.")
@click.option("--workers", type=click.IntRange(0, 1024), help="Tasks side by side  [default: one a core]")
def generalisation(
    corpus: Path | None,
    output: Path,
    scale: str,
    select: tuple[str, ...],
    subsets: tuple[str, ...],
    metric: str,
    device: str,
    sandbox: str,
    executor: str,
    scheduler: str | None,
    workers: int | None,
    **given: Any,
) -> None:
    """Does an agent that was trained on many environments play better than chance in others?

    The environments are parted into folds; for each, an agent learns from all the others and is tested in those held
    out. Without CORPUS, variants of the family tetris are written for it. The same command goes on with a study that
    was ended, and writes DIR/report.md, DIR/report.html and what they are made from.
    """
    with uninterrupted():
        for name in _NEEDED:
            if importlib.util.find_spec(name) is None:
                raise UsageError(f"a study needs {name}; install it with `pip install 'envcraft-rl[report,train]'`")
        from envcraft_dqn.study.experiment import Experiment
    protocol = _protocol(scale, subsets, given)
    plugin = _plugin(executor, scheduler)
    began = time.monotonic()
    experiment = Experiment.prepare(protocol, corpus, output, select, metric, sandbox, device, workers)
    click.echo(f"{experiment.told()}; all of it is kept in {output}", err=True)

    def tell(result: Result, done: int, total: int) -> None:
        minutes = (time.monotonic() - began) / 60
        click.echo(f"{done} of {total}  {minutes:6.1f} min  {result.task.name}  {result.seconds:.0f} s", err=True)

    with contextlib.suppress(BrokenPipeError):
        click.echo(experiment.run(plugin, workers, scheduler, tell))


def _protocol(scale: str, subsets: tuple[str, ...], given: dict[str, Any]) -> Protocol:
    """The scale with what was given in its place. Raises UsageError."""
    import msgspec

    from envcraft_dqn.study.scales import SCALES

    known = SCALES[scale]
    own = {name: given[name] for name in _OWN if given[name] is not None}
    training = {name: given[name] for name in _TRAINING if given[name] is not None}
    pairs = []
    for one in subsets:
        size, _, count = one.partition(":")
        if not (size.isdigit() and count.isdigit() and int(size) and int(count)):
            raise UsageError(f"--subset {one} is no SIZE:SPLITS, such as 500:5")
        pairs.append((int(size), int(count)))
    own["controls"] = min(own.get("controls", known.controls), own.get("folds", known.folds))
    settings = msgspec.structs.replace(known.settings, **training)
    return msgspec.structs.replace(known, **own, subsets=tuple(pairs), settings=settings)


def _plugin(executor: str, scheduler: str | None) -> ExecutorPlugin:
    """Raises UsageError."""
    from envcraft.commands.choices import executor_named
    from envcraft_dqn.study.local import LocalExecutor

    found = executor_named(executor)
    if found is None and scheduler is not None:
        raise UsageError("--scheduler goes with --executor dask")
    return found or LocalExecutor()
