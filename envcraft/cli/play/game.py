"""The game loop: what to show, which keys count, and when to take the next step."""

from __future__ import annotations

import contextlib
import textwrap
import time
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from typing import Any

from envcraft.cli.play.episode import Episode
from envcraft.cli.play.keys import ABOUT, AGAIN, QUIT, Keys
from envcraft.cli.play.screen import Screen
from envcraft.model.trace import Ending, Trace
from envcraft.text import one_line, plural

#: Seconds between two polls of the keys, while waiting for the player and for the environment.
_LOOK, _GLANCE = 0.01, 0.002


class Wish(Enum):
    """The player's next wish."""

    QUIT = "quit"
    AGAIN = "again"


class Game:
    """Episodes on a screen. With `fps` None, each step waits for a key.

    The description is shown first, and again by the key ``?``; the game waits for the next key.
    """

    def __init__(
        self, screen: Screen, keys: Keys, title: str, fps: float | None, description: Sequence[str] = ()
    ) -> None:
        self._screen = screen
        self._keys = keys
        self._title = title
        self._fps = fps
        self._description = list(description)
        self._reading = bool(description)
        self._help = [
            *keys.help,
            *(["each step waits for a key" + ("; enter does nothing" if keys.idle else "")] if fps is None else []),
            ", ".join(["r next episode", "q quit", *(["? the description"] if description else [])]),
        ]

    def play(self, episode: Episode) -> Wish | None:
        """Play until the episode ends, which gives None, or until the player wants something else."""
        due = time.monotonic()
        shown = -1
        # In turn-based play, keys may arrive before the environment needs them.
        chosen: deque[Any] = deque()
        while not episode.over:
            wait = _LOOK if episode.waiting else _GLANCE
            if self._fps is not None and episode.waiting and not self._reading:
                wait = min(wait, max(due - time.monotonic(), 0.0))
            for key in self._screen.pressed(wait):
                if key in QUIT:
                    return Wish.QUIT
                if key == AGAIN:
                    return Wish.AGAIN
                # The key that ends the reading counts in the game, too.
                self._reading = key == ABOUT and bool(self._description)
                shown = -1
                if self._fps is None and (action := self._keys.turn(key)) is not None:
                    chosen.append(action)
            if not episode.waiting:
                continue
            trace = episode.shown.trace
            if trace.steps != shown:
                shown = trace.steps
                self._show(episode, f"step {trace.steps}, return {trace.total:g}")
            now = time.monotonic()
            if self._reading:
                due = now
            elif self._fps is not None and now >= due:
                chosen.append(self._keys.held(self._screen.held()))
                due = max(due + 1 / self._fps, now)
            if chosen:
                episode.give(chosen.popleft())
        return None

    def rest(self, episode: Episode, notes: list[str]) -> Wish:
        """Show how an episode ended, and wait for the player's wish."""
        self._show(episode, result(episode.shown.trace), notes)
        while True:
            for key in self._screen.pressed(0.1):
                if key in QUIT:
                    return Wish.QUIT
                if key == AGAIN:
                    return Wish.AGAIN

    def _show(self, episode: Episode, state: str, notes: list[str] | None = None) -> None:
        watched = episode.shown
        text = textwrap.wrap(watched.text, 76)[:12] if watched.picture is None else []
        state = f"{self._title}, seed {episode.seed}: {state}"
        if self._reading and notes is None:
            text = [state, "", *self._description, ""]
            state = "press a key to play"
        self._screen.show(watched.picture, [*text, state, *(notes or self._help)])


def result(trace: Trace) -> str:
    """Summarise an episode: success if it is known, steps and return."""
    ends: dict[Ending, str] = {
        Ending.TERMINATED: "ended",
        Ending.TRUNCATED: "cut by its limit",
        Ending.CUT: "stopped",
    }
    success = {True: "success", False: "no success", None: ""}[trace.success]
    why = trace.fault or (trace.end and trace.end.detail) or ""
    broke = f"broke ({one_line(why)})" if why else "broke"
    words = [ends.get(trace.ending, broke), success, f"return {trace.total:g}", plural(trace.steps, "step")]
    return ", ".join(word for word in words if word)


Ended = Callable[[Trace], list[str]]


def play_all(game: Game, begin: Callable[[int], Episode], seed: int, ended: Ended) -> None:
    """Play episodes from `seed` until the player quits; `ended` receives each trace and returns lines to show."""
    while True:
        with contextlib.closing(begin(seed)) as episode:
            try:
                wish = game.play(episode)
            finally:
                # An episode that Ctrl-C ends is recorded, too.
                episode.stop()
                notes = ended(episode.finish())
            if wish is None:
                wish = game.rest(episode, [*notes, "r next episode, q quit"])
        if wish is Wish.QUIT:
            return
        seed += 1
