"""What the worker says in words of its own, a file's description and a search's outcome: checked before it is read.

Code that shares a process with the worker can send what it likes in its name. What is not of the form here raises
MalformedValue, which ends the job as forged.
"""

from __future__ import annotations

from typing import Annotated, Any, TypedDict

import msgspec

from envcraft.errors import MalformedValue
from envcraft.model.job import SearchOutcome
from envcraft.spaces.spec import SpaceSpec, read_space
from envcraft.spaces.validation import validate_action

_Digest = Annotated[str, msgspec.Meta(pattern=r"\A[0-9a-f]{64}\Z")]
_Name = Annotated[str, msgspec.Meta(max_length=1000)]


class DefinedClass(TypedDict):
    """An environment class, and the line at which it is defined."""

    name: str
    line: int | None


class Effects(TypedDict, total=False):
    """What importing the file did: seconds it took, whether global generators moved on, threads that it started."""

    seconds: float
    random: bool
    numpy_random: bool
    threads: int


#: ``class`` is no name that the class syntax takes. The last five are told of what is installed: the module and digest
#: of the file that defines the class, the type that was ``made`` and whether it is an ``environment``, and the
#: ``modules`` that it imports.
Description = TypedDict(
    "Description",
    {
        "classes": list[DefinedClass],
        "lookalikes": list[str],
        "effects": Effects,
        "class": str,
        "line": int | None,
        "required": list[str],
        "lines": dict[str, int | None],
        "observation_space": dict[str, Any],
        "action_space": dict[str, Any],
        "reset": list[str],
        "render_modes": list[str],
        "nondeterministic": bool,
        "module": _Name,
        "sha256": _Digest | None,
        "made": _Name,
        "environment": bool,
        "modules": list[str],
    },
    total=False,
)


def describe(value: dict[str, Any]) -> Description:
    """Read a description. Raises MalformedValue."""
    description: Description = _convert(value, Description)
    for name in ("observation_space", "action_space"):
        if name in description:
            read_space(description[name])
    return description


def outcome(value: dict[str, Any], action_space: SpaceSpec, most: int) -> SearchOutcome:
    """Read a search's outcome, whose action lists are in `action_space` and no longer than `most`. Raises
    MalformedValue.
    """
    found: SearchOutcome = _convert(value, SearchOutcome)
    for name, actions in (("crash", found.get("crash")), ("win", found.get("win")), ("best", found.get("best"))):
        if len(actions or []) > most:
            raise MalformedValue(f"{name} is a list more than {most} actions")
        for action in actions or []:
            if wrong := validate_action(action_space, action):
                raise MalformedValue(f"{name}: {wrong}")
    return found


def _convert(value: dict[str, Any], kind: Any) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise MalformedValue(str(error)) from None
