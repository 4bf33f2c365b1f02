"""Schemas of three messages of the worker: the description of a file, the outcome of a search, and a state's fields.

Untrusted code shares a process with the worker and can send any bytes. A message that does not fit its schema raises
MalformedValue, which ends the job as forged.
"""

from __future__ import annotations

from typing import Annotated, Any, TypedDict

import msgspec
from envcraft_protocol.wire import MAX_FIELD_LINES, MAX_FIELDS, MAX_LOOKS, MAX_PATH, MAX_SHOWN

from envcraft.errors import MalformedValue
from envcraft.model.job import SearchOutcome
from envcraft.model.trace import StateChange
from envcraft.spaces.spec import SpaceSpec, read_space
from envcraft.spaces.validation import validate_action

_Digest = Annotated[str, msgspec.Meta(pattern=r"\A[0-9a-f]{64}\Z")]
_Name = Annotated[str, msgspec.Meta(max_length=1000)]
_Path = Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_PATH)]
_Field = tuple[
    _Path, Annotated[str, msgspec.Meta(pattern=r"\A[0-9a-f]{32}\Z")], Annotated[str, msgspec.Meta(max_length=MAX_SHOWN)]
]
_Line = Annotated[int, msgspec.Meta(ge=0, lt=2**31)]


class DefinedClass(TypedDict):
    """An environment class and the line of its definition."""

    name: str
    line: int | None


class UnfinishedClass(DefinedClass):
    """One that leaves methods to subclasses: `reset` or `step`, and `abstract` ones, each with the class it is from."""

    lacks: list[_Name]
    abstract: list[tuple[_Name, _Name]]


class Effects(TypedDict, total=False):
    """Side effects of the import: the seconds without those of libraries, whether it used the global generators, the
    number of threads started.
    """

    seconds: float
    random: bool
    numpy_random: bool
    threads: int


class Rendering(TypedDict):
    """What the constructor did with the render mode: whether it takes one, whether it is `optional` with None as its
    default, which it was `given` and which the instance has; whether the metadata has the `rate` of the frames, with
    the rate as `fps` if it is a number in reason; and the keys that it has from old versions of Gym.
    """

    takes: bool
    optional: bool
    given: _Name | None
    kept: _Name | None
    rate: bool
    fps: Annotated[float, msgspec.Meta(gt=0)] | None
    old: list[_Name]


#: The functional syntax, because ``class`` is a keyword. ``renders`` says whether the class has a render() of its own.
#: ``line`` is that of the class, or that at which the target's file imports or assigns it; ``elsewhere`` then has the
#: class, its file and its line. ``lines`` has the methods that the file of the class defines, and ``inherited`` the
#: classes, files and lines that the others come from. The keys between ``nondeterministic`` and ``modules`` are sent
#: only for installed environments: the module, path and digest of the file that defines the class, the type of the
#: object that was ``made``, and whether that is an ``environment``. ``modules`` are those that the target imports, of a
#: file without the standard library.
Description = TypedDict(
    "Description",
    {
        "classes": list[DefinedClass],
        "lookalikes": list[str],
        "wrappers": list[_Name],
        "unfinished": list[UnfinishedClass],
        "effects": Effects,
        "class": str,
        "line": int | None,
        "elsewhere": _Name,
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


class _Fields(TypedDict):
    """Of one state, see :class:`envcraft_protocol.jobs.Fields`."""

    changed: Annotated[list[_Field], msgspec.Meta(max_length=MAX_FIELDS)]
    gone: Annotated[list[_Path], msgspec.Meta(max_length=MAX_FIELDS)]
    lines: Annotated[list[_Line], msgspec.Meta(max_length=MAX_FIELD_LINES)]


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
    names = (result.get("player", ""), result.get("place", ""), result.get("board", ""))
    if not all(len(name) <= MAX_SHOWN and name.isprintable() for name in names):
        raise MalformedValue("an attribute whose name is too long or cannot be printed")
    if len(result.get("enclosed", ())) > result.get("looked", 0) or result.get("looked", 0) > MAX_LOOKS:
        raise MalformedValue("more seeds than a search looks at")
    if result.get("loop_length", 0) > len(result.get("loop") or []):
        raise MalformedValue("a loop that is longer than its actions")
    return result


def fields(value: dict[str, Any]) -> StateChange:
    """Validate the fields of a state that changed.

    Raises:
        MalformedValue: they do not fit the schema, or a text cannot be printed.
    """
    found: _Fields = _convert(value, _Fields)
    if not all(text.isprintable() for path, _, shown in found["changed"] for text in (path, shown)):
        raise MalformedValue("a field whose text cannot be printed")
    changed = {path: (digest, shown) for path, digest, shown in found["changed"]}
    return StateChange(changed, tuple(found["gone"]), frozenset(found["lines"]))


def _convert(value: dict[str, Any], kind: Any) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise MalformedValue(str(error)) from None
