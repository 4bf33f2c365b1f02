"""The layers that read sources: what is the same in them and what is not, and that no source breaks them."""

from __future__ import annotations

import time

import pytest

from envcraft.similarity import exact, near, structural
from envcraft.similarity.reading import MAX_BYTES
from tests.similarity.games import RENAMES, RULES, game, reformatted, renamed

HOSTILE = {
    "no text": b"\xff\xfe\x00x = 1\n",
    "null": b"x = 1\0\n",
    "unfinished": b"def f(:\n  '''",
    "no words": b"$ ? $\n",
    "indents": b"".join(b" " * depth + b"if x:\n" for depth in range(150)),
    "brackets": b"x = " + b"(" * 5000 + b"1" + b")" * 5000,
    "signs": b"x = " + b"-" * 20_000 + b"1\n",
    "sum": b"x = " + b"+".join([b"1"] * 20_000) + b"\n",
    "attributes": b"x = a" + b".b" * 20_000 + b"\n",
    "digits": b"x = 0x" + b"f" * 20_000 + b"\n",
    "huge": b"x = 1\n" * (MAX_BYTES // 6 + 1),
    "surrogate": b"x = '\\ud800'\n",
    "match": b"match x:\n case [a, *b] | {'k': a, **b}:\n  print(a, b)\n",
    "empty": b"",
}


def test_keys_ignore_formatting() -> None:
    source = game(0)
    assert reformatted(source) != source
    for layer in (exact, structural, near):
        assert layer.key(reformatted(source)) == layer.key(source), layer.__name__


def test_crlf_and_a_byte_order_mark() -> None:
    written = b"\xef\xbb\xbf" + game(1).replace(b"\n", b"\r\n")
    assert exact.key(written) == exact.key(game(1))
    assert structural.key(written) == structural.key(game(1))


def test_names_are_exact_but_not_structural() -> None:
    source = game(0)
    assert exact.key(renamed(source)) != exact.key(source)
    assert structural.key(renamed(source)) == structural.key(source)


@pytest.mark.parametrize("old", [old for old, _ in RENAMES])
def test_each_kind_of_name(old: str) -> None:
    new = dict(RENAMES)[old]
    one = game(0).decode().replace(old, new).replace('"hearts"', '"lives"')
    assert one.encode() != game(0)
    assert structural.key(one.encode()) == structural.key(game(0))


@pytest.mark.parametrize(
    ("one", "two"),
    [
        ("def f(a, b):\n    return g(a, k=b)\n", "def f(x, y):\n    return g(x, k=y)\n"),
        ("def f(a):\n    return f(a=a)\n", "def f(b):\n    return f(b=b)\n"),
        ("import numpy\nx = numpy.pi\n", "import numpy as np\ny = np.pi\n"),
        ("def f(x: int = 1) -> int:\n    y: int = x\n    return y\n", "def f(x=1):\n    y = x\n    return y\n"),
        ("try:\n    f()\nexcept OSError as e:\n    print(e)\n", "try:\n    f()\nexcept OSError as w:\n    print(w)\n"),
        ("def f():\n    i = 1\ndef g():\n    j = 1\n", "def f():\n    i = 1\ndef g():\n    i = 1\n"),
        ("N = 1\ndef f():\n    global N\n    N = 2\n", "M = 1\ndef f():\n    global M\n    M = 2\n"),
    ],
)
def test_the_same_under_other_names(one: str, two: str) -> None:
    assert structural.key(one.encode()) == structural.key(two.encode())


@pytest.mark.parametrize(
    ("one", "two"),
    [
        # A constant, a library's name, the order of names, the scope of one.
        ("x = 1\n", "x = 2\n"),
        ("x = 1\n", "x = 1.0\n"),
        ("x = 1\n", "x = True\n"),
        ("x = 'a'\n", "x = b'a'\n"),
        ("x = range(3)\n", "x = list(3)\n"),
        ("import numpy as np\nx = np.zeros(3)\n", "import numpy as np\nx = np.ones(3)\n"),
        ("import random\n", "import secrets\n"),
        ("def f(a, b):\n    return a - b\n", "def f(a, b):\n    return b - a\n"),
        ("x = g(k=1)\n", "x = g(m=1)\n"),
        ("def f():\n    x = 1\n    def g():\n        x = 2\n",
         "def f():\n    x = 1\n    def g():\n        nonlocal x\n        x = 2\n"),
        ("class A:\n    def f(self): return self.x\n    def g(self): self.x = 1; self.y = 2\n",
         "class A:\n    def f(self): return self.y\n    def g(self): self.x = 1; self.y = 2\n"),
        ("x = a + b\n", "x = a - b\n"),
        ("def f(a, *, b): pass\n", "def f(a, b): pass\n"),
        ("def f(a, b=1): pass\n", "def f(a=1, b=1): pass\n"),
    ],
)  # fmt: skip
def test_other_programs(one: str, two: str) -> None:
    assert structural.key(one.encode()) != structural.key(two.encode())
    assert exact.key(one.encode()) != exact.key(two.encode())


def test_no_two_games_have_one_key() -> None:
    for layer in (exact, structural):
        assert len({layer.key(game(number)) for number in range(len(RULES))}) == len(RULES)


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_sources(name: str) -> None:
    started = time.process_time()
    for layer in (exact, structural, near):
        layer.key(HOSTILE[name])
    assert time.process_time() - started < 5


@pytest.mark.parametrize("name", ["no text", "unfinished", "no words", "huge"])
def test_unreadable_source_has_only_an_exact_key(name: str) -> None:
    source = HOSTILE[name]
    assert structural.key(source) is None
    assert near.key(source) is None
    assert exact.key(source) == exact.key(bytes(source))
    assert exact.key(source) != exact.key(source + b" ")


@pytest.mark.parametrize("name", ["sum", "attributes"])
def test_what_nests_too_deeply_has_no_structure(name: str) -> None:
    assert structural.key(HOSTILE[name]) is None


def test_nothing_is_run(tmp_path: object) -> None:
    source = f"open({str(tmp_path)!r} + '/ran', 'w')\nraise SystemExit\n".encode()
    for layer in (exact, structural, near):
        assert layer.key(source) is not None
