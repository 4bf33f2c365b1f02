"""What the commands that run stages have in common: where generated code is judged, and which model answers."""

from __future__ import annotations

import importlib.util
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.commands.choices import contract_named, driver_named, select_checks
from envcraft.errors import SandboxUnavailable, UsageError
from envcraft.sandbox import Driver, Isolation
from envcraft.stages import Stage, ordered
from envcraft_llm.endpoint import ModelChoice

if TYPE_CHECKING:
    from envcraft.corpus.settings import Settings
    from envcraft_llm.endpoint.accounts import Accounts
    from envcraft_llm.model import Model

    from .judging import Judges

#: How ``--model`` names answers that ship, and what they take the place of after a colon.
DEMO = "demo"


def is_demo(chosen: ModelChoice) -> bool:
    """Whether the answers are those that ship, or of a folder, rather than an endpoint's; an endpoint may have a model
    that is called like ``demo:7b``.
    """
    name, _, folder = chosen.model.partition(":")
    if name != DEMO:
        return False
    return not folder or not chosen.base_url or Path(folder).is_dir()


def demo_folder(chosen: ModelChoice) -> Path:
    """The folder whose answers are replayed: that of ``demo:FOLDER``, or the one that ships."""
    from envcraft_llm.demo_model import FOLDER

    _, _, folder = chosen.model.partition(":")
    return Path(folder) if folder else FOLDER


def playable(chosen: ModelChoice, driver: Driver) -> None:
    """Look whether the games of the demo that ships find their library where they are judged: an image has it. Raises
    UsageError.
    """
    from envcraft_llm.demo_model import FOLDER

    there = driver.isolation is Isolation.CONTAINER or importlib.util.find_spec("pygame") is not None
    if not there and demo_folder(chosen) == FOLDER:
        raise UsageError("the demo's games need pygame; install it with `pip install 'envcraft-rl[play]'`")


def opened(chosen: ModelChoice, journal: Path | None, offline: bool = False) -> tuple[Model, Accounts | None]:
    """The model that answers, and its accounts; those that ship cost nothing. Raises UsageError."""
    if is_demo(chosen):
        from envcraft_llm.demo_model import DemoModel

        return DemoModel(demo_folder(chosen)), None
    from envcraft_llm.endpoint import open_model

    model = open_model(chosen, journal, offline)
    return model, model.accounts


def answerable(chosen: ModelChoice, corpus: Path, offline: bool) -> None:
    """Look whether there is anything that answers, before anything is written. Raises UsageError."""
    if is_demo(chosen):
        return
    if offline:
        from envcraft_llm.endpoint.journal import JOURNAL

        if not (corpus / JOURNAL).is_file():
            raise UsageError(f"{corpus / JOURNAL} does not exist: without an endpoint there is nothing to answer from")
    else:
        # Not at the start of every command.
        from envcraft_llm.endpoint.connection import check

        check(chosen)


def named(chosen: ModelChoice, stage: str) -> str:
    """The name of the model for a stage."""
    return DEMO if is_demo(chosen) else chosen.of(stage)


def driver_for_generated(sandbox: str, least: str | None, runtime: str | None) -> Driver:
    """The sandbox for code that nobody has read: not the weakest one, unless it is named. Raises UsageError,
    SandboxUnavailable.
    """
    if sandbox != "auto" or least is not None:
        return driver_named(sandbox, least, runtime)
    try:
        return driver_named(sandbox, Isolation.NAMESPACE.value, runtime)
    except SandboxUnavailable as error:
        raise SandboxUnavailable(
            f"generated code is run in a container or a namespace, and neither can be had here ({error}); "
            "--sandbox process runs it in a process that holds against accidents, not against malice"
        ) from None


def judges(driver: Driver, budget: str, workers: int | None) -> tuple[Judges, Settings]:
    """What judges generated environments, by all checks of the contract ``arcade``, and how that is written down."""
    from envcraft.budget import BUDGETS
    from envcraft.corpus.settings import settings_of

    from .judging import Judges

    contract, checks = contract_named("arcade"), select_checks(None, None)
    settings = settings_of(contract, checks, driver, BUDGETS[budget], 0)
    return Judges(contract, driver, checks, BUDGETS[budget], workers), settings


def offered_stages() -> list[Stage]:
    """The stages of all plugins, in their order. Raises UsageError."""
    from envcraft.cli import offered

    return ordered(offered("envcraft_stages"))


def running(stages: Iterable[Stage], wanted: Collection[str]) -> list[Stage]:
    """The stages that run: optional ones only where they are `wanted`."""
    return [stage for stage in stages if not stage.optional or stage.name in wanted]


def stage_named(name: str | None, stages: list[Stage]) -> str:
    """Raises UsageError, naming the nearest."""
    from envcraft.cli import unknown

    names = [stage.name for stage in stages]
    if name is not None and name not in names:
        raise UsageError(f"there is no stage {unknown(name, names)}")
    return name or ""
