"""The fields that a job reads from environments, hostile ones included."""

from __future__ import annotations

import enum
import itertools
import random
import sys
import time
from collections import Counter, OrderedDict, defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pygame
import pytest
from envcraft_protocol.wire import MAX_FIELD_LINES, MAX_FIELDS, MAX_PATH, MAX_SHOWN, MAX_STATES_BYTES, Kind
from envcraft_sandbox.worker.fields import Fields

from envcraft.judging.description import fields as read


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # A job's working directory has the modules of its project.
    monkeypatch.chdir(tmp_path)


class Channel:
    """Keeps what would be sent, as the host reads it."""

    def __init__(self) -> None:
        self.states: list[Any] = []
        self.bytes = 0

    def send(self, kind: Kind, payload: bytes) -> None:
        import json

        assert kind is Kind.FIELDS
        self.bytes += len(payload)
        self.states.append(read(json.loads(payload)))


class Env(gymnasium.Env[Any, Any]):
    it: Any
    c: Any

    def __init__(self, **attributes: Any) -> None:
        vars(self).update(attributes)


def fields(env: Any, module: ModuleType | None = None) -> tuple[Fields, Channel]:
    channel = Channel()
    subject: Any = SimpleNamespace(channel=channel, target=SimpleNamespace(filename=__file__, module=module))
    return Fields(subject, env), channel


def kind(value: Any) -> str:
    return type(value).__name__


def state(value: Any) -> dict[str, str]:
    """The fields of an attribute ``it``, with their texts."""
    reading, channel = fields(Env(it=value), ModuleType("empty"))
    reading.send()
    return {path: shown for path, (_, shown) in channel.states[0].changed.items() if "self.it" in path}


def digests(value: Any) -> dict[str, str]:
    reading, channel = fields(Env(it=value), ModuleType("empty"))
    reading.send()
    return {path: digest for path, (digest, _) in channel.states[0].changed.items() if "self.it" in path}


class Mood(enum.Enum):
    CALM = 0
    ANGRY = 1


@dataclass
class Ball:
    x: float = 0.5
    marks: list[Any] = field(default_factory=list)


class Slotted:
    __slots__ = ("__hidden", "shown", "unset")

    def __init__(self) -> None:
        self.shown, self.__hidden = 1, 2


class Bag(list[Any]):
    def __init__(self, items: Any) -> None:
        super().__init__(items)
        self.owner = "me"


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (3, {"self.it": "3"}),
        (0.25, {"self.it": "0.25"}),
        ("a\nb", {"self.it": "'a\\nb'"}),
        (None, {"self.it": "None"}),
        ([1, (2, "x")], {"self.it": "[1, (2, 'x')]"}),
        ((1,), {"self.it": "(1,)"}),
        (np.int64(4), {"self.it": "4"}),
        (np.float32(0.5), {"self.it": "0.5"}),
        (np.arange(3), {"self.it": "[0, 1, 2]"}),
        (np.zeros((84, 84, 3), np.uint8), {"self.it": "an array of uint8 (84, 84, 3)"}),
        (Mood.ANGRY, {"self.it": "Mood.ANGRY"}),
        ({"a": 1}, {"len(self.it)": "1", "self.it['a']": "1"}),
        (
            {(1, 2): 3, 4: [5]},
            {"len(self.it)": "2", "self.it[(1, 2)]": "3", "self.it[4]": "[5]", "list(self.it)": "[(1, 2), 4]"},
        ),
        ({5}, {"self.it": "{5}"}),
        ({3, 1, 2}, {"self.it": "{1, 2, 3}", "iter(self.it)": "[1, 2, 3]"}),
        (deque([1, 2]), {"len(self.it)": "2", "self.it[0]": "1", "self.it[1]": "2"}),
        (Ball(), {"self.it.x": "0.5", "self.it.marks": "[]"}),
        ([Ball(), Ball(1.5)], {
            "len(self.it)": "2", "self.it[0].x": "0.5", "self.it[0].marks": "[]", "self.it[1].x": "1.5",
            "self.it[1].marks": "[]",
        }),
        (Slotted(), {"self.it._Slotted__hidden": "2", "self.it.shown": "1"}),
        (Bag([Slotted]), {"len(self.it)": "1", "self.it.owner": "'me'"}),
        (SimpleNamespace(a=1), {"self.it.a": "1"}),
        (pygame.Rect(1, 2, 3, 4), {"self.it": repr(pygame.Rect(1, 2, 3, 4))}),
        (random.Random(1), {"self.it": ""}),
        (np.random.default_rng(1), {"self.it": ""}),
        (itertools.count(7), {"self.it": "count(7)"}),
        (Counter(a=2), {"len(self.it)": "1", "self.it['a']": "2"}),
        (OrderedDict(a=2), {"len(self.it)": "1", "self.it['a']": "2"}),
        (defaultdict(int, a=2), {"len(self.it)": "1", "self.it['a']": "2"}),
        (np.array([1, "x"], object), {"self.it.flat[0]": "1", "self.it.flat[1]": "'x'"}),
        (pygame.Surface((2, 2)), {}),
        (len, {}),
        (Ball, {}),
        (sys, {}),
        (object(), {}),
    ],
)  # fmt: skip
def test_fields_and_their_texts(value: Any, shown: dict[str, str]) -> None:
    assert state(value) == shown


def drawn(generator: Any) -> Any:
    generator.random()
    return generator


@pytest.mark.parametrize(
    ("one", "two"),
    [
        (1, True),
        (1, 1.0),
        ("1", 1),
        (0.0, -0.0),
        ([1, 2], (1, 2)),
        ([12], [1, 2]),
        (["a, b"], ["a", "b"]),
        (10**4000, 10**4000 + 1),
        (np.zeros(300), np.append(np.zeros(299), 1.0)),
        (np.zeros(2, np.int8), np.zeros(2, np.int16)),
        (np.zeros((2, 3)), np.zeros((3, 2))),
        (random.Random(1), drawn(random.Random(1))),
        (np.random.default_rng(1), drawn(np.random.default_rng(1))),
        (np.random.RandomState(1), drawn(np.random.RandomState(1))),
        (np.random.default_rng(1), np.random.Generator(np.random.MT19937(1))),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
        (["x" * 500], ["x" * 499 + "y"]),
        (list(range(150)), [*range(149), 0]),
        (list(range(5_000)), [*range(4_999), 0]),
    ],
    ids=kind,
)
def test_what_differs_has_another_digest(one: Any, two: Any) -> None:
    assert digests(one) != digests(two)


@pytest.mark.parametrize(
    ("one", "two"),
    [
        ({"a", "b", "c"}, {"c", "b", "a"}),
        (frozenset("abc"), frozenset("cba")),
        ({Ball: 1}, {Ball: 2}),
        (float("nan"), float("nan")),
    ],
)
def test_what_is_equal_has_the_same_digest(one: Any, two: Any) -> None:
    assert digests(one).get("self.it") == digests(two).get("self.it")


def refuse(*_: Any, **__: Any) -> Any:
    raise SystemExit("a method of the subject ran")


METHODS = (
    *("__getattribute__", "__repr__", "__str__", "__eq__", "__hash__", "__len__", "__iter__", "__bool__", "__index__"),
    *("__reduce_ex__", "__deepcopy__", "__array__", "__float__", "__int__", "__lt__", "__contains__", "__getitem__"),
    *("items", "keys", "values", "bit_length", "tolist", "tobytes", "item", "getstate", "get_state", "copy"),
)


def trapped(base: type, name: str = "Trap") -> Any:
    return type(name, (base,), {"__module__": __name__, **dict.fromkeys(METHODS, refuse)})


class Meta(type):
    __instancecheck__ = __subclasscheck__ = __getattribute__ = __eq__ = __hash__ = refuse


Told: Any = type("Told", (), {"__dict__": property(refuse), "__class__": property(refuse)})


TRAPS: dict[str, Any] = {
    **{base.__name__: trapped(base)() for base in (object, dict, list, set, tuple, deque, str, int, float)},
    "ndarray": np.zeros(3).view(trapped(np.ndarray)),
    "Random": random.Random.__new__(trapped(random.Random), 3),  # type: ignore[call-arg]
    "metaclass": type.__call__(Meta, "Odd", (), {}),
    "properties": Told(),
    "a class whose name is no text": type("Odd", (), {"__module__": trapped(str)("x")})(),
}


@pytest.mark.parametrize("name", TRAPS)
def test_no_method_of_the_subject_is_called(name: str) -> None:
    trap = TRAPS[name]
    inside = {"trap": 0, "list": [0, trap], "values": 3}
    held = Env(it=trap, held=[trap, 1], inside=inside, after="read")
    reading, channel = fields(held, ModuleType("empty"))
    reading.send()
    changed = channel.states[0].changed
    assert changed["self.after"][1] == "'read'"
    assert changed["self.inside['values']"][1] == "3"


def deep() -> Any:
    made: Any = []
    for _ in range(5_000):
        made = [made]
    return made


def wide() -> Any:
    made: Any = [0]
    for _ in range(60):
        made = [made, made]
    return made


def ring() -> Any:
    made: Any = {}
    made["again"] = [made]
    return made


#: Made by the test: each process of pytest-xdist collects all tests, and would keep the values to its end.
HUGE_AND_ODD: list[Callable[[], Any]] = [
    deep,
    wide,
    ring,
    lambda: "x" * 10**7,
    lambda: list(range(10**6)),
    lambda: [[number] for number in range(10**5)],
    lambda: {number: [number] for number in range(10**5)},
    lambda: set(range(10**5)),
    lambda: 10**100_000,
    lambda: np.zeros((5_000, 5_000)),
    lambda: [Ball(marks=[Ball() for _ in range(40)]) for _ in range(400)],
    lambda: {"k" * 10**6: 1},
    lambda: b"x" * 10**6,
    lambda: SimpleNamespace(**{f"field_{number}": number for number in range(5_000)}),
    lambda: SimpleNamespace(**{"x" * 10**5: 1}),
    lambda: {"\ud800": "\ud800"},
    lambda: "\u202e\x1b[31m",
    lambda: {"\x1b[31m": 2},
]


@pytest.mark.parametrize("make", HUGE_AND_ODD)
def test_huge_and_odd_values_cost_little(make: Callable[[], Any]) -> None:
    reading, channel = fields(Env(it=make(), after=1), ModuleType("empty"))
    started = time.process_time()
    for _ in range(3):
        reading.send()
    assert time.process_time() - started < 10
    assert channel.states[0].changed
    for path, (_, shown) in channel.states[0].changed.items():
        assert len(path) <= MAX_PATH
        assert len(shown) <= MAX_SHOWN
        assert (path + shown).isprintable()
    assert len(channel.states[0].changed) <= MAX_FIELDS


def test_only_changes_are_sent() -> None:
    env = Env(a=1, b=[1, 2], c=3)
    reading, channel = fields(env, ModuleType("empty"))
    reading.send()
    reading.send()
    vars(env).update(a=5, d=4)
    del env.c
    reading.send()
    first, second, third = channel.states
    assert {"self.a", "self.b", "self.c"} <= first.changed.keys()
    assert (second.changed, second.gone) == ({}, ())
    assert ({path: shown for path, (_, shown) in third.changed.items()}, third.gone) == (
        {"self.a": "5", "self.d": "4"},
        ("self.c",),
    )


def test_a_job_sends_no_more_than_the_host_takes() -> None:
    env = Env(it=[])
    reading, channel = fields(env, ModuleType("empty"))
    for number in range(300):
        env.it = [f"{number} {item} {'x' * 300}" for item in range(150)]
        reading.send()
    assert 0 < len(channel.states) < 300
    assert channel.bytes <= MAX_STATES_BYTES


def test_objects_are_let_go() -> None:
    ball = Ball()
    env = Env(ball=ball, own=[ball])
    before = sys.getrefcount(ball)
    reading, _ = fields(env, ModuleType("empty"))
    reading.send()
    assert sys.getrefcount(ball) == before


MODULE = """
import random
import numpy as np
LEVELS = [[1, 2], [3, 4]]
dice = random.Random(3)
count = 0
class Game:
    trail = []
    limit: int = 5
    @property
    def size(self): raise SystemExit
    def put(self, here, where=[], *, names={}, plain=3): pass
    @staticmethod
    def add(item, items=[7]): pass
def spawn(made=[]): pass
class Wall: pass
"""


def test_what_is_shared_is_read_before_the_instance() -> None:
    module = ModuleType("game")
    exec(MODULE, vars(module))
    env = Env(own=vars(module)["LEVELS"], trail=vars(module)["Game"].trail)
    reading, channel = fields(env, module)
    reading.send()
    paths = list(channel.states[0].changed)
    assert [path for path in paths if not path.startswith("self.")] == [
        "random", "numpy.random", "LEVELS", "dice", "count", "Game.trail", "Game.limit", "Game.put(where)",
        "len(Game.put(names))", "Game.add(items)", "spawn(made)",
    ]  # fmt: skip


def test_the_lines_of_a_call_are_those_of_its_file() -> None:
    reading, channel = fields(Env(), ModuleType("empty"))

    def called(times: int) -> int:
        total = 0
        for number in range(times):
            total += Counter([number])[number]
        return total

    before = sys.gettrace()
    assert reading.watching(called)(3) == 3
    assert sys.gettrace() is before
    reading.send()
    reading.send()
    first = called.__code__.co_firstlineno
    assert channel.states[0].lines == frozenset(range(first + 1, first + 5))
    assert channel.states[1].lines == frozenset()
    assert reading.watching(called)(100_000) == 100_000
    with pytest.raises(ZeroDivisionError):
        reading.watching(lambda: 1 // 0)()
    assert sys.gettrace() is before


def test_no_more_lines_are_sent_than_the_host_takes() -> None:
    reading, channel = fields(Env(), ModuleType("empty"))
    names: dict[str, Any] = {}
    exec(compile("def long():\n" + "    x = 1\n" * 5_000, __file__, "exec"), names)
    reading.watching(names["long"])()
    reading.send()
    assert len(channel.states[0].lines) == MAX_FIELD_LINES
