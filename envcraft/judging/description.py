"""Schemas of two messages of the worker: the description of a file and the outcome of a search.

Untrusted code shares a process with the worker and can send any bytes. A message that does not fit its schema raises
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
    """An environment class and the line of its definition."""

    name: str
    line: int | None


class Effects(TypedDict, total=False):
    """Side effects of the import: its seconds, whether it used the global generators, the number of threads started."""

    seconds: float
    random: bool
    numpy_random: bool
    threads: int


class Rendering(TypedDict):
    """What the constructor did with the render mode: whether it takes one, which it was `given` and which the instance
    has; and whether the metadata has the `rate` of the frames, with the rate as `fps` if it is a number in reason.
    """

    takes: bool
    given: _Name | None
    kept: _Name | None
    rate: bool
    fps: Annotated[float, msgspec.Meta(gt=0)] | None


#: The functional syntax, because ``class`` is a keyword. ``renders`` says whether
#: the class has a render() of its own. ``lines`` has the methods that the file of the class defines, and ``inherited``
#: the classes that the others come from. The keys between ``nondeterministic`` and ``modules`` are sent
#: only for installed environments: the module, path and digest of the file that defines the class, the type of the
#: object that was ``made``, and whether that is an ``environment``. ``modules`` are those that the target imports, of a
#: file without the standard library.
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
        "inherited": dict[str, _Name],
        "observation_space": dict[str, Any],
        "action_space": dict[str, Any],
        "reset": list[str],
        "render_modes": list[str],
        "renders": bool,
        "rendering": Rendering,
        "nondeterministic": bool,
        "module": _Name,
        "file": _Name,
        "sha256": _Digest | None,
        "made": _Name,
        "environment": bool,
        "modules": list[str],
    },
    total=False,
)


def describe(value: dict[str, Any]) -> Description:
    """Validate a description.

    Raises:
        MalformedValue: it does not fit the schema.
    """
    description: Description = _convert(value, Description)
    for name in ("observation_space", "action_space"):
        if name in description:
            read_space(description[name])
    return description


def outcome(value: dict[str, Any], action_space: SpaceSpec, most: int) -> SearchOutcome:
    """Validate a search's outcome.

    Args:
        value: the message.
        action_space: contains every action of the outcome's lists.
        most: the maximum length of a list of actions.

    Raises:
        MalformedValue: it does not fit the schema, or a list is too long or has an action outside the space.
    """
    result: SearchOutcome = _convert(value, SearchOutcome)
    lists = {"crash": result.get("crash"), "win": result.get("win"), "best": result.get("best")}
    for name, actions in {**lists, "loop": result.get("loop"), "still": result.get("still")}.items():
        if len(actions or []) > most:
            raise MalformedValue(f"{name} is a list of more than {most} actions")
        for action in actions or []:
            if wrong := validate_action(action_space, action):
                raise MalformedValue(f"{name}: {wrong}")
    if result.get("loop_length", 0) > len(result.get("loop") or []):
        raise MalformedValue("a loop that is longer than its actions")
    return result


def _convert(value: dict[str, Any], kind: Any) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise MalformedValue(str(error)) from None
