"""What the commands that run stages share: the model, the sandbox and the order of the stages."""

from __future__ import annotations

import importlib.util
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.contracts.lookup import contract_named
from envcraft.errors import SandboxUnavailable, UsageError
from envcraft.generation.stages import Stage
from envcraft.judging.driver import Driver, Isolation
from envcraft.judging.selection import driver_named, select_checks
from envcraft.model.stage_order import ordered
from envcraft_llm.endpoint import ModelSettings

if TYPE_CHECKING:
    from envcraft.judging.settings import Settings
    from envcraft_llm.endpoint.usage import UsageTracker
    from envcraft_llm.model import Model

    from .judging import JudgeExecutor

#: The value of ``--model`` for recorded answers; a folder may follow after a colon.
DEMO = "demo"


def is_demo(settings: ModelSettings) -> bool:
    """Whether answers are recorded ones. An endpoint may have a model with a name such as ``demo:7b``."""
    name, _, folder = settings.model.partition(":")
    if name != DEMO:
        return False
    return not folder or not settings.base_url or Path(folder).is_dir()


def demo_answers(settings: ModelSettings) -> Path:
    """Return the recorded answers to replay: the folder of ``demo:FOLDER``, or the archive that ships."""
    from envcraft_llm.recorded import ARCHIVE

    _, _, folder = settings.model.partition(":")
    return Path(folder) if folder else ARCHIVE


def check_demo_games(settings: ModelSettings, driver: Driver) -> None:
    """Check that the games of the demo that ships can import pygame where they run; a container image has it.

    Raises:
        UsageError: If they cannot.
    """
    from envcraft_llm.recorded import ARCHIVE

    installed = driver.isolation is Isolation.CONTAINER or importlib.util.find_spec("pygame") is not None
    if not installed and demo_answers(settings) == ARCHIVE:
        raise UsageError("the demo's games need pygame; install it with `pip install 'envcraft-rl[play]'`")


def create_model(
    settings: ModelSettings, journal: Path | None, offline: bool = False
) -> tuple[Model, UsageTracker | None]:
    """Create the model, and its usage tracker; recorded answers have none.

    Raises:
        UsageError: If the settings name no usable endpoint, journal or recorded answers.
        EnvCraftError: If the journal cannot be used.
    """
    if is_demo(settings):
        from envcraft_llm.recorded import RecordedModel

        return RecordedModel(demo_answers(settings)), None
    from envcraft_llm.endpoint import open_model

    model = open_model(settings, journal, offline)
    return model, model.usage


def check_model(settings: ModelSettings, corpus: Path, offline: bool) -> None:
    """Check that the model can be created, before anything is written.

    Raises:
        UsageError: If it cannot.
    """
    if is_demo(settings):
        return
    if offline:
        from envcraft_llm.endpoint.journal import JOURNAL

        if not (corpus / JOURNAL).is_file():
            raise UsageError(f"{corpus / JOURNAL} does not exist: without an endpoint, completions come from a journal")
    else:
        # Imported here because it is slow to import.
        from envcraft_llm.endpoint.connection import check_endpoint

        check_endpoint(settings)


def model_for(settings: ModelSettings, stage: str) -> str:
    """Return the name of the model for a stage."""
    return DEMO if is_demo(settings) else settings.model_for(stage)


def driver_for_generated(sandbox: str, least: str | None, runtime: str | None) -> Driver:
    """Return the sandbox driver for unreviewed code: ``auto`` never selects the driver ``process``.

    Raises:
        UsageError: If `sandbox` is unknown.
        SandboxUnavailable: If the driver does not work here.
    """
    if sandbox != "auto" or least is not None:
        return driver_named(sandbox, least, runtime)
    try:
        return driver_named(sandbox, Isolation.NAMESPACE.value, runtime)
    except SandboxUnavailable as error:
        raise SandboxUnavailable(
            f"generated code needs a container or a namespace, and neither works here ({error}); "
            "--sandbox process runs it in a process, which protects against accidents but not against malicious code"
        ) from None


def judge_executor(driver: Driver, budget: str, workers: int | None) -> tuple[JudgeExecutor, Settings]:
    """Return the executor of all checks under the contract ``arcade``, and the settings of its verdicts."""
    from envcraft.judging.budget import BUDGETS
    from envcraft.judging.settings import settings_of

    from .judging import JudgeExecutor

    contract, checks = contract_named("arcade"), select_checks(None, None)
    settings = settings_of(contract, checks, driver, BUDGETS[budget], 0)
    return JudgeExecutor(contract, driver, checks, BUDGETS[budget], workers), settings


def offered_stages() -> list[Stage]:
    """Return the stages of all plugins, in order. Raises UsageError."""
    from envcraft.registry import offered

    return ordered(offered("envcraft_stages"))


def enabled_stages(stages: Iterable[Stage], named: Collection[str]) -> list[Stage]:
    """Return the stages that run: an optional stage runs only if `named` contains it."""
    return [stage for stage in stages if not stage.optional or stage.name in named]


def check_stage_name(name: str | None, stages: list[Stage]) -> str:
    """Return the name, or "" for None. Raises UsageError if there is no such stage."""
    from envcraft.registry import did_you_mean

    names = [stage.name for stage in stages]
    if name is not None and name not in names:
        raise UsageError(f"there is no stage {did_you_mean(name, names)}")
    return name or ""
