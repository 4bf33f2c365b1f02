"""The model ``demo``: answers that ship with EnvCraft, so that the whole cascade runs without an endpoint.

A folder has one folder for each concept, ``NN_<id>`` with the concept's number, and in it what a model answered:
``brief.md``, ``viability.json``, ``attempt_0.py`` and those of the repairs, ``policy_0.py`` and those of its repairs.
An attempt that is not there is answered with the last one that is. What the checks say of all this is not recorded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from envcraft.errors import UsageError

from .concepts.generation import concepts
from .concepts.writing import Concept
from .model import Answer, Model, ModelFailure, Request

FOLDER = Path(__file__).parent / "demo"
#: The concepts of the demo are the first of this seed.
SEED = 0
_NAME = re.compile(r"(\d+)_([0-9a-f]+)")
_FILES = {"code": "attempt", "repair": "attempt", "privileged": "policy"}
_WORDS = {
    "code": "Here is the complete environment.",
    "repair": "The cause was found, and this is the repaired file.",
    "privileged": "This policy plays from the state of the game.",
}


class DemoModel(Model):
    """Answers by stage, concept and attempt from a folder. Raises UsageError where there is none."""

    def __init__(self, folder: Path = FOLDER) -> None:
        self._folders = {concept: place for _, concept, place in _listed(folder)}
        if not self._folders:
            raise UsageError(f"{folder} holds no concept of a demo: folders that are called like 00_32c62bc38e25ac99")

    async def ask(self, request: Request) -> Answer:
        """Raises ModelFailure where the folder has nothing to answer with."""
        place = self._folders.get(request.concept)
        text = "" if place is None else _answer(place, request)
        if not text:
            words = f"the demo has no answer for the stage {request.stage} of the concept {request.concept}"
            raise ModelFailure("empty", words)
        return Answer(text, model="demo")


def demo_concepts(folder: Path = FOLDER) -> list[Concept]:
    """The concepts that a folder has answers for, in their order. Raises UsageError on one that is not of the seed."""
    listed = list(_listed(folder))
    made = list(concepts(max((number for number, _, _ in listed), default=-1) + 1, SEED)) if listed else []
    for number, concept, place in listed:
        if made[number].id != concept:
            raise UsageError(f"{place} is no concept of seed {SEED}: number {number} is {made[number].id}")
    return [made[number] for number, _, _ in listed]


def _listed(folder: Path) -> Iterator[tuple[int, str, Path]]:
    """The number, the id and the place of each concept in a folder, in order."""
    try:
        places = sorted(folder.iterdir())
    except OSError:
        return
    for place in places:
        if (named := _NAME.fullmatch(place.name)) and place.is_dir():
            yield int(named[1]), named[2], place


def _answer(place: Path, request: Request) -> str:
    """What was answered; "" for nothing."""
    if request.stage == "briefs":
        return _read(place / "brief.md")
    if request.stage == "elaboration":
        return _read(place / "elaboration.md")
    if request.stage == "viability":
        return _read(place / "viability.json")
    kind = _FILES.get(request.stage)
    for number in range(request.attempt, -1, -1) if kind else ():
        if source := _read(place / f"{kind}_{number}.py"):
            return f"{_WORDS[request.stage]}\n\n```python\n{source.rstrip()}\n```\n"
    return ""


def _read(file: Path) -> str:
    return file.read_text("utf-8") if file.is_file() else ""
