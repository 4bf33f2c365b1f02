"""Options that several commands share."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click
import msgspec

from envcraft.cli import completion
from envcraft.errors import UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Isolation
from envcraft.judging.selection import split
from envcraft.registry import offered

if TYPE_CHECKING:
    from envcraft.model.target import PolicyFile

_F = TypeVar("_F", bound=Callable[..., Any])

#: More than any machine has cores. Each worker takes a thread.
MOST_WORKERS = 1024

runtime_option = click.option(
    "--runtime", metavar="NAME", help="Container runtime of the docker sandbox, such as runsc for gVisor."
)


def sandbox_options(sandbox: str | None = "auto") -> Callable[[_F], _F]:
    """Add ``--sandbox``, ``--runtime``, ``--require-isolation`` and ``--workers`` to a command that judges.

    Args:
        sandbox: the default of ``--sandbox``; None for the sandbox that a record names.
    """
    return _together(
        click.option(
            "--sandbox",
            default=sandbox,
            show_default=sandbox is not None or "as recorded",
            metavar="NAME",
            shell_complete=completion.sandboxes,
            help="The sandbox that runs the environments: auto, docker, bubblewrap or process.",
        ),
        runtime_option,
        click.option(
            "--require-isolation",
            type=click.Choice([level.value for level in Isolation]),
            help="Require at least this isolation level.",
        ),
        click.option(
            "--workers",
            type=click.IntRange(1, MOST_WORKERS),
            show_default="one per core",
            help="The number of jobs that run in parallel.",
        ),
    )


def policy_option() -> Callable[[_F], _F]:
    """Add ``--policy``, which :func:`policy_of` reads."""
    return click.option(
        "--policy",
        metavar="FILE|PLAYER",
        shell_complete=completion.files,
        help="A Python file with a privileged policy, or a player that has one, such as composer. The check difficulty "
        "plays it.",
    )


def policy_of(name: str | None, common: bool = False) -> PolicyFile | None:
    """The privileged policy that ``--policy`` names. Raises UsageError if there is none.

    Args:
        name: its file, or the name of a player.
        common: whether it is for many environments, some of which it may not be able to play.
    """
    if not name:
        return None
    from envcraft.demonstrations.player import policy_named

    try:
        return msgspec.structs.replace(policy_named(name), common=common)
    except UsageError as error:
        names = [player.name for player in offered("envcraft_players") if player.policy is not None]
        known = "name a Python file" + (f", or a player that has a policy: {', '.join(names)}" if names else "")
        raise UsageError(str(error) if os.path.exists(name) else f"{error}; {known}", setting="policy") from None


def format_option() -> Callable[[_F], _F]:
    """Add ``--format``, also spelled ``--output-format``."""
    return click.option(
        "--format",
        "--output-format",
        "form",
        show_default="by the name of --output, else console",
        metavar="NAME",
        shell_complete=completion.formats,
        help="The format of the report.",
    )


def output_option() -> Callable[[_F], _F]:
    """Add ``--output``."""
    return click.option(
        "--output",
        metavar="FILE",
        shell_complete=completion.files,
        help="Write the report to this file; - means standard output.",
    )


class _Stages(click.ParamType[Any]):
    """Names of budgets, each once."""

    name = "A,B"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        if isinstance(value, tuple):
            return value
        names = tuple(split(str(value)))
        for name in names:
            if name not in BUDGETS or names.count(name) > 1:
                self.fail(f"{value!r} is not a budget, or a list of different budgets, of {', '.join(BUDGETS)}")
        return names or self.fail("there is no budget")


def check_options(stages: bool = False) -> Callable[[_F], _F]:
    """Add the options of a command that judges: ``--contract``, ``--checks``, ``--skip``, ``--budget``, ``--seed``,
    ``--time-limit`` and ``--fail-fast``.

    Args:
        stages: ``--budget`` may name several budgets.
    """
    more = ". If there are several, such as quick,standard, each judges only what passes the one before"
    return _together(
        click.option(
            "--contract",
            default="arcade",
            show_default=True,
            metavar="NAME",
            shell_complete=completion.contracts,
            help="The interface that the environments promise; `envcraft contracts` lists them.",
        ),
        click.option(
            "--checks",
            metavar="A,B",
            shell_complete=completion.checks,
            help="Run only these checks. The checks source and sandbox always run; an opt-in check runs only if it is "
            "named.",
        ),
        click.option("--skip", metavar="A,B", shell_complete=completion.checks, help="Do not run these checks."),
        click.option(
            "--budget",
            type=_Stages() if stages else click.Choice(list(BUDGETS)),
            default="standard",
            show_default=True,
            help=f"How much to play: a larger budget finds rarer defects and takes longer{more if stages else ''}.",
        ),
        click.option(
            "--seed",
            type=click.IntRange(0, 2**31 - 1),
            default=0,
            show_default=True,
            help="Seed of all episodes. The same seed gives the same verdict.",
        ),
        click.option(
            "--time-limit",
            type=click.FloatRange(0, min_open=True),
            metavar="SECONDS",
            help="Time for each environment. Checks that are not decided by then are skipped.  "
            f"[default: {', '.join(f'{budget.seconds:g} for {name}' for name, budget in BUDGETS.items())}]",
        ),
        click.option("--fail-fast", is_flag=True, help="End each environment at its first error."),
    )


def _together(*options: Callable[[Any], Any]) -> Callable[[_F], _F]:
    """Join several decorators, in the order in which ``--help`` lists the options."""

    def decorate(command: _F) -> _F:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate
