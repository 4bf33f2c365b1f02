"""Defects that no trace shows: waiting, leaks, threads."""

from __future__ import annotations

from benchmarks.mutation.operator import Places, operator
from benchmarks.mutation.operators.parts import first
from benchmarks.mutation.source import Source


@operator("EC90", "EC91", "EC05", silent=True)
def sleeps(game: Source) -> Places:
    """Sleep for a frame of a display in each step."""
    yield [*game.imported("time"), game.before(first(game, "step"), "time.sleep(1 / 60)")]


@operator("EC90", "EC91", "EC05", silent=True)
def frames_kept(game: Source) -> Places:
    """Keep every frame in a list of the module."""
    if len(game.pictured) == 1 and game.picture is not None:
        value = game.pictured[0]
        yield [
            game.before(game.env, "HISTORY = []", "", ""),
            game.replace(value, f"HISTORY.append({game.of(value)}) or HISTORY[-1].copy()"),
        ]


@operator("EC90", "EC91", "EC05", silent=True)
def thread_started(game: Source) -> Places:
    """Start a thread at each reset that never ends."""
    if game.seeding is not None:
        started = "threading.Thread(target=threading.Event().wait, daemon=True).start()"
        yield [*game.imported("threading"), game.after(game.seeding, started)]


@operator("EC90", "EC91", "EC05", silent=True)
def file_left_open(game: Source) -> Places:
    """Open a file at each reset and keep it open."""
    if game.seeding is not None:
        yield [
            *game.imported("os"),
            game.before(game.env, "FILES = []", "", ""),
            game.after(game.seeding, "FILES.append(open(os.devnull))"),
        ]


@operator("EC90", "EC91", "EC05", silent=True)
def slower_each_step(game: Source) -> Places:
    """Go through all earlier steps of all episodes in each step."""
    yield [
        game.before(game.env, "STEPS = []", "", ""),
        game.before(first(game, "step"), "STEPS.append(1)", "self.total = sum(x * x for x in STEPS for _ in range(3))"),
    ]
