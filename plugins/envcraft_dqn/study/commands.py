"""The command ``envcraft study``. Importing this module does not import torch."""

from __future__ import annotations

import contextlib
import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from envcraft.cli import completion
from envcraft.cli.group import ListingGroup
from envcraft.cli.signals import uninterrupted
from envcraft.errors import UsageError
from envcraft_dqn.settings import AUGMENTATIONS, OBJECTIVES, SIZES

if TYPE_CHECKING:
    from envcraft.corpus.executors import ExecutorPlugin
    from envcraft_dqn.study.protocol import Protocol
    from envcraft_dqn.study.worker import TaskResult

_F = TypeVar("_F", bound=Callable[..., Any])
_LIBRARIES = ("jinja2", "matplotlib", "numba", "safetensors", "tensorboard", "torch", "zstandard")
_LOCAL = "local"
_PRESET = "set by the scale"
#: The value of ``--subset`` and ``--where`` for none.
_NONE = "none"
#: Options that override the preset, and those that override the settings of its trainings.
_PROTOCOL = (
    "variants",
    "folds",
    "episodes",
    "privileged_episodes",
    "recorded",
    "splits",
    "seeds",
    "controls",
    "familiar",
    "threads",
    "seed",
)
_TRAINING = (
    "size",
    "objective",
    "augment",
    "steps",
    "pretrain_updates",
    "demonstrations",
    "learning_rate",
    "demonstration_share",
    "batch",
)


@click.group(cls=ListingGroup)
def study() -> None:
    """Run experiments over many environments."""


def _count(name: str, text: str, minimum: int = 1) -> Callable[[_F], _F]:
    """An option that overrides a number of the preset."""
    return click.option(f"--{name}", type=click.IntRange(minimum), show_default=_PRESET, help=text)


_EXECUTION = (
    click.option("--seed", type=click.IntRange(0, 2**31 - 1), default=0, show_default=True, help="Random seed."),
    click.option(
        "--device", default="auto", show_default=True, metavar="NAME", help="Torch device, such as cpu or cuda."
    ),
    click.option(
        "--sandbox",
        default="auto",
        show_default=True,
        metavar="NAME",
        shell_complete=completion.sandboxes,
        help="Sandbox of the privileged player.",
    ),
    click.option(
        "--executor", default=_LOCAL, show_default=True, metavar="NAME", help="Executor of the tasks: local or dask."
    ),
    click.option("--scheduler", metavar="ADDRESS", help="Scheduler address of the dask cluster."),
    click.option("--workers", type=click.IntRange(0, 1024), help="Number of parallel tasks.  [default: one per core]"),
)


def _execution(command: _F) -> _F:
    """The options on where and how tasks run."""
    for option in reversed(_EXECUTION):
        command = option(command)
    return command


@study.command()
@click.argument("corpus", metavar="[CORPUS]", required=False, type=click.Path(path_type=Path))
@click.option("--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="Folder of the study.")
@click.option(
    "--scale",
    type=click.Choice(["smoke", "laptop", "gpu", "reference"]),
    default="laptop",
    show_default=True,
    help="Size of the study.",
)
@click.option(
    "--select", multiple=True, metavar="PATTERN", help="Select environments whose names match, such as 'tetris_*'."
)
@_count("variants", "Number of environments to generate without a corpus.", 2)
@_count("folds", "Number of folds of the cross-validation.", 2)
@_count("splits", "Number of splits whose agents train and are tested; 0 means all.", 0)
@_count("episodes", "Episodes of each environment and player.", 2)
@_count("privileged-episodes", "Episodes of the privileged player; 0 disables it.", 0)
@_count("recorded", "Demonstrated steps to record in each environment.", 0)
@_count("seeds", "Number of agents with different seeds.")
@_count("controls", "Number of splits with the controls that need training.", 0)
@_count("familiar", "Number of training environments in which each agent is tested as well.", 0)
@click.option(
    "--subset",
    "subsets",
    multiple=True,
    metavar="SIZE:SPLITS",
    help="Also train on this many environments in this many splits, or none. Can be repeated.",
)
@click.option(
    "--where",
    multiple=True,
    metavar="AXIS=VALUE",
    show_default=_PRESET,
    help="Generate only environments with this value on an axis, such as board.rows=16, or none. Can be repeated.",
)
@click.option(
    "--metric",
    type=click.Choice(["auto", "length", "return"]),
    default="auto",
    show_default=True,
    help="Metric: length or return of episodes.",
)
@click.option("--size", type=click.Choice(list(SIZES)), show_default=_PRESET, help="Size of the network.")
@click.option("--objective", type=click.Choice(OBJECTIVES), show_default=_PRESET, help="Objective of the agents.")
@click.option("--augment", type=click.Choice(AUGMENTATIONS), show_default=_PRESET, help="Augmentation of frames.")
@_count("steps", "Environment steps of each training.", 0)
@_count("pretrain-updates", "Updates on demonstrations alone, before online training.", 0)
@_count("demonstrations", "Demonstrated steps in each environment.", 0)
@click.option("--learning-rate", type=click.FloatRange(0), show_default=_PRESET, help="Learning rate of Adam.")
@click.option(
    "--demonstration-share",
    type=click.FloatRange(0, 1),
    show_default=_PRESET,
    help="Share of demonstrations in online batches.",
)
@_count("batch", "Transitions in an update.")
@_count("threads", "Threads of each task.")
@_execution
def generalisation(
    corpus: Path | None,
    output: Path,
    scale: str,
    select: tuple[str, ...],
    subsets: tuple[str, ...],
    where: tuple[str, ...],
    metric: str,
    device: str,
    sandbox: str,
    executor: str,
    scheduler: str | None,
    workers: int | None,
    **options: Any,
) -> None:
    """Measure how agents generalise to held-out environments.

    The study splits the environments into folds. For each fold, an agent trains on all other environments and is tested
    on the fold. Without CORPUS, the study generates variants of the family tetris. The same command resumes an
    interrupted study, and writes DIR/report.md, DIR/report.html and their data.
    """
    _require_libraries()
    with uninterrupted():
        from envcraft_dqn.study.experiment import Experiment
    if corpus is not None and where:
        raise UsageError(f"--where is for environments that the study generates, not for those of {corpus}")
    protocol = _protocol(scale, subsets, where, options)
    plugin = _plugin(executor, scheduler)
    started = time.monotonic()
    experiment = Experiment.prepare(protocol, corpus, output, select, metric, sandbox, device, workers)
    click.echo(f"{experiment.summary()}; output in {output}", err=True)

    with contextlib.suppress(BrokenPipeError):
        click.echo(experiment.run(plugin, workers, scheduler, _reporter(started)))


@study.command()
@click.option("--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="Folder of the study.")
@click.option(
    "--scale",
    type=click.Choice(["smoke", "laptop", "gpu"]),
    default="laptop",
    show_default=True,
    help="Size of the study.",
)
@click.option(
    "--family",
    "families",
    multiple=True,
    metavar="NAME",
    shell_complete=completion.families,
    help="A family to study. Repeat the option to name at least two.  [default: all]",
)
@click.option(
    "--further",
    multiple=True,
    type=click.IntRange(1),
    metavar="STEPS",
    help="Steps of further training in the held-out family. Can be repeated.",
)
@_count("variants", "Number of environments of each family.", 2)
@_count("episodes", "Episodes of each environment and player.", 2)
@_count("steps", "Environment steps of the training on the other families.", 0)
@_count("pretrain-updates", "Updates on demonstrations alone, before online training.", 0)
@_count("threads", "Threads of each task.")
@_execution
def transfer(
    output: Path,
    scale: str,
    families: tuple[str, ...],
    further: tuple[int, ...],
    device: str,
    sandbox: str,
    executor: str,
    scheduler: str | None,
    workers: int | None,
    **options: Any,
) -> None:
    """Measure how training transfers between families.

    For each family, an agent trains on all other families. It is tested in the family without further training, and
    after several numbers of steps there, compared with agents from random weights. The same command resumes an
    interrupted study, and writes DIR/report.md, DIR/report.html and their data.
    """
    import msgspec

    from envcraft.registry import offered

    _require_libraries()
    with uninterrupted():
        from envcraft_dqn.study.experiment import Experiment
        from envcraft_dqn.study.presets import FURTHER, TRANSFER
    preset = TRANSFER[scale]
    training = {name: options.pop(name) for name in ("steps", "pretrain_updates")}
    settings = msgspec.structs.replace(
        preset.settings, **{name: value for name, value in training.items() if value is not None}
    )
    own = {name: value for name, value in options.items() if value is not None}
    protocol = msgspec.structs.replace(preset, **own, settings=settings)
    names = families or tuple(sorted(family.name for family in offered("envcraft_families")))
    plugin = _plugin(executor, scheduler)
    started = time.monotonic()
    steps = sorted(set(further or FURTHER[scale]))
    experiment = Experiment.prepare_transfer(protocol, output, names, steps, sandbox, device, workers)
    click.echo(f"{experiment.summary()}; output in {output}", err=True)
    with contextlib.suppress(BrokenPipeError):
        click.echo(experiment.run(plugin, workers, scheduler, _reporter(started)))


def _require_libraries() -> None:
    """Raises UsageError without the libraries of a study."""
    for name in _LIBRARIES:
        if importlib.util.find_spec(name) is None:
            raise UsageError(f"a study needs {name}; install it with `pip install 'envcraft-rl[report,train]'`")


def _reporter(started: float) -> Callable[[TaskResult, int, int], None]:
    """Reports each result on stderr."""

    def on_result(result: TaskResult, done: int, total: int) -> None:
        minutes = (time.monotonic() - started) / 60
        click.echo(f"{done} of {total}  {minutes:6.1f} min  {result.task.name}  {result.seconds:.0f} s", err=True)

    return on_result


def _protocol(scale: str, subsets: tuple[str, ...], where: tuple[str, ...], options: dict[str, Any]) -> Protocol:
    """The preset with the given options. Raises UsageError."""
    import msgspec

    from envcraft_dqn.study.presets import PRESETS

    preset = PRESETS[scale]
    own = {name: options[name] for name in _PROTOCOL if options[name] is not None}
    training = {name: options[name] for name in _TRAINING if options[name] is not None}
    pairs = []
    for one in () if subsets == (_NONE,) else subsets:
        size, _, count = one.partition(":")
        if not (size.isdigit() and count.isdigit() and int(size) and int(count)):
            raise UsageError(f"--subset {one} is not SIZE:SPLITS, such as 500:5")
        pairs.append((int(size), int(count)))
    if subsets:
        own["subsets"] = tuple(pairs)
    if where:
        own["where"] = () if where == (_NONE,) else where
    own["recorded"] = max(own.get("recorded", preset.recorded), training.get("demonstrations", 0))
    folds = own.get("folds", preset.folds)
    own["splits"] = min(own.get("splits", preset.splits), folds)
    own["controls"] = min(own.get("controls", preset.controls), own["splits"] or folds)
    settings = msgspec.structs.replace(preset.settings, **training)
    return msgspec.structs.replace(preset, **own, settings=settings)


def _plugin(executor: str, scheduler: str | None) -> ExecutorPlugin:
    """The executor with this name. Raises UsageError."""
    from envcraft.corpus.executors import executor_named
    from envcraft_dqn.study.local import LocalExecutor

    found = executor_named(executor)
    if found is None and scheduler is not None:
        raise UsageError("--scheduler needs --executor dask")
    return found or LocalExecutor()
