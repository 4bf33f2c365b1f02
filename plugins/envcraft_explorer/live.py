"""One person or one player at one environment: messages of the page in, frames out.

The page sends JSON: first the environment, with a player if it only watches; then ``start``, ``press``, ``release``,
``step``, ``pause``, ``rate`` and ``save``. The answers are JSON, and one binary message for each frame: the length of a
JSON text in four bytes, the text, and the pixels in RGB. ``started`` comes before the first frame of each episode. The
session ends with the connection and at its limits.

A player plays its episode at once. Its actions are then taken again, step by step, at the rate of the environment.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import struct
import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec
from starlette.websockets import WebSocket, WebSocketDisconnect

from envcraft.cli.play.episode import Watched
from envcraft.cli.play.game import result
from envcraft.cli.play.keys import Keys, keys_for
from envcraft.cli.play.recorded import Played
from envcraft.demonstrations.player import Player
from envcraft.errors import EnvCraftError, Skip, UsageError
from envcraft.judging.engine import Plan, open_subject, report_on
from envcraft.judging.frame_renderer import pixels, with_frames
from envcraft.judging.interactive import InteractiveEpisode
from envcraft.judging.subject import Subject
from envcraft.model.rollout import Conditions
from envcraft.model.target import Target
from envcraft.model.trace import Trace
from envcraft.model.verdict import CheckReport, Report, Verdict
from envcraft.text import one_line
from envcraft_explorer.stage import Stage, rate_of

_STEPS = 100_000
_MAX_SEED = 2**31 - 1
_MAX_TEXT = 2_000
#: The keys that count at a time.
_HELD = 8
_T = TypeVar("_T")


@dataclass(frozen=True)
class Limits:
    """When a session ends.

    Attributes:
        idle: seconds without a message of the page; a player that plays needs none.
        longest: seconds of the whole session.
    """

    idle: float = 600.0
    longest: float = 3_600.0


class _Message(msgspec.Struct, rename={"act": "do"}):
    """A message of the page; the fields that an action does not use are ignored."""

    act: str = "start"
    environment: str = ""
    number: int = -1
    player: str = ""
    seed: int = 0
    key: str = ""
    held: list[str] = []
    on: bool = False
    rate: float = 15.0


class _Episode(InteractiveEpisode[Watched]):
    """An episode whose turns wake the event loop."""

    def __init__(self, subject: Subject, seed: int, conditions: Conditions, loop: asyncio.AbstractEventLoop) -> None:
        self._loop, self._turn = loop, asyncio.Event()
        super().__init__(subject, seed, conditions, "a person", subject.contract.limit or _STEPS, Watched)
        self._pending.task.future.add_done_callback(lambda _: self.action_requested())

    def action_requested(self) -> None:
        # The loop may have ended before the job did.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._turn.set)

    async def turn(self) -> None:
        """Wait until the job requests an action or ends."""
        await self._turn.wait()
        self._turn.clear()


class Session:
    """The session of one connection.

    Args:
        socket: the connection, accepted.
        stage: the environments.
        threads: run what waits for the sandbox.
        names: the names of the environments by the number that the page knows.
        limits: when it ends.
    """

    def __init__(
        self, socket: WebSocket, stage: Stage, threads: Executor, names: Callable[[], list[str]], limits: Limits
    ) -> None:
        self._socket, self._stage, self._threads, self._names = socket, stage, threads, names
        self._limits, self._ends = limits, time.monotonic() + limits.longest
        self._inbox: asyncio.Queue[_Message | None] = asyncio.Queue()
        self._gone = asyncio.Event()
        #: The keys that are down, and those that were down since the last step; the last pressed at the end.
        self._held: list[str] = []
        self._tapped: list[str] = []
        self._paused, self._rate, self._due = False, 15.0, 0.0
        self._episode: _Episode | None = None
        #: What a player played; None if a person plays.
        self._played: Trace | None = None

    async def run(self) -> None:
        """Serve the connection until it ends."""
        try:
            first = _read(await self._socket.receive_text())
            with self._stage.place():
                await self._play(first)
        except (EnvCraftError, Skip) as error:
            await self._tell("refused", words=one_line(error))
        except WebSocketDisconnect:
            pass

    async def _play(self, first: _Message) -> None:
        plan, target, player = await self._aside(lambda: self._opened(first))
        subject = open_subject(plan, target)
        reader = asyncio.create_task(self._receive())
        try:
            keys, conditions = await self._aside(lambda: _prepare(subject, player is None))
            if player is not None and not await self._let(player, subject, first.seed):
                return
            self._rate = rate_of(subject)
            known = {} if keys is None else {"turns": not keys.idle, "help": keys.help, "pad": keys.pad}
            await self._tell("ready", rate=self._rate, **known)
            await self._loop(plan, subject, keys, conditions, first)
        finally:
            reader.cancel()
            # Also when the connection is gone: nothing may keep the worker.
            await asyncio.shield(self._aside(lambda: self._close(subject)))

    def _opened(self, first: _Message) -> tuple[Plan, Target, Player | None]:
        """How the environment is played, its target, and who plays if it is no person. Raises UsageError."""
        name, player = self._name(first), None
        if first.player:
            player = self._stage.players(name).get(first.player)
            if player is None:
                raise UsageError(f"there is no player {one_line(first.player)}")
        return *self._stage.plan(name, None if player is None else player.policy), player

    async def _let(self, player: Player, subject: Subject, number: int) -> bool:
        """Let a player play its episode; False if the connection ends before that.

        Raises:
            UsageError: it takes too long.
            EnvCraftError: the sandbox failed.
            Skip: the player cannot play it.
        """
        playing = asyncio.ensure_future(self._aside(lambda: player.play(subject, max(number, 0))))
        gone = asyncio.ensure_future(self._gone.wait())
        left = self._ends - time.monotonic()
        await asyncio.wait({playing, gone}, timeout=left, return_when=asyncio.FIRST_COMPLETED)
        gone.cancel()
        if playing.done():
            self._played = playing.result()
            return True
        # Without its workers, the player cannot go on.
        await self._aside(subject.close)
        await asyncio.wait({playing})
        playing.exception()
        if self._gone.is_set():
            return False
        raise UsageError(f"the player {one_line(player.name)} takes longer than a session may last")

    def _name(self, first: _Message) -> str:
        """The name of the environment: the page shows names whose unprintable characters are replaced."""
        names = self._names()
        if 0 <= first.number < len(names) and one_line(names[first.number]) == first.environment:
            return names[first.number]
        raise UsageError(f"the corpus has no environment {one_line(first.environment)}")

    async def _loop(
        self, plan: Plan, subject: Subject, keys: Keys | None, conditions: Conditions, message: _Message | None
    ) -> None:
        idle = time.monotonic() + self._limits.idle
        while True:
            if message is not None:
                await self._obey(message, plan, subject, keys, conditions)
                idle = time.monotonic() + self._limits.idle
            ticks = self._running and not self._paused and (keys is None or keys.idle)
            ends = self._ends if ticks and keys is None else min(self._ends, idle)
            if time.monotonic() >= ends:
                break
            due = min(self._due, ends) if ticks else ends
            try:
                # wait_for() without time to wait takes nothing from a queue.
                wait = max(due - time.monotonic(), 0.0)
                message = (
                    self._inbox.get_nowait() if self._inbox.qsize() else await asyncio.wait_for(self._inbox.get(), wait)
                )
            except TimeoutError:
                message = None
                if ticks and time.monotonic() >= self._due:
                    self._due = max(self._due + 1 / self._rate, time.monotonic())
                    await self._tick(keys)
            else:
                if message is None:
                    return
        await self._tell("ended", words="The session is over: play again to start another one")

    async def _receive(self) -> None:
        try:
            while True:
                await self._inbox.put(_read(await self._socket.receive_text()))
        except (WebSocketDisconnect, EnvCraftError):
            self._gone.set()
            await self._inbox.put(None)

    async def _obey(
        self, message: _Message, plan: Plan, subject: Subject, keys: Keys | None, conditions: Conditions
    ) -> None:
        if message.act == "start":
            await self._aside(self._leave)
            seed = message.seed if self._played is None else self._played.rollout.seed
            self._episode = _Episode(subject, min(max(seed, 0), _MAX_SEED), conditions, asyncio.get_running_loop())
            self._paused, self._due = message.on, time.monotonic()
            self._tapped = []
            await self._tell("started")
            await self._show()
        elif message.act == "pause":
            self._paused, self._due = message.on, time.monotonic()
        elif message.act == "rate" and math.isfinite(message.rate):
            self._rate = min(max(message.rate, 1.0), 60.0)
        elif message.act == "step" and (keys is None or keys.idle):
            await self._tick(keys)
        elif keys is None:
            return
        elif message.act in ("press", "release"):
            await self._press(message, keys)
        elif message.act == "save":
            await self._save(plan, subject)

    async def _press(self, message: _Message, keys: Keys) -> None:
        self._held = message.held[-_HELD:]
        if message.act == "release":
            return
        if keys.idle and not self._paused:
            self._tapped = [*self._tapped, message.key][-_HELD:]
        elif (action := keys.turn(message.key)) is not None:
            await self._step(action)

    async def _tick(self, keys: Keys | None) -> None:
        """Take the step that is due: with the held keys, or as the player did."""
        if keys is not None:
            await self._step(self._action(keys))
        elif self._episode is not None and self._running and self._played is not None:
            steps, actions = self._episode.shown.trace.steps, self._played.actions
            if steps < len(actions):
                await self._step(actions[steps])
            else:
                self._episode.stop()
                await self._show()

    def _action(self, keys: Keys) -> Any:
        """The action of the keys that are or were down since the last step."""
        held = [*(key for key in self._tapped if key not in self._held), *self._held]
        self._tapped = []
        return keys.held(held)

    @property
    def _running(self) -> bool:
        return self._episode is not None and not self._episode.over

    async def _step(self, action: Any) -> None:
        if self._episode is not None and self._running:
            self._episode.give(action)
            await self._show()

    async def _show(self) -> None:
        """Wait for the result of a call, and send its frame."""
        episode = self._episode
        assert episode is not None
        await episode.turn()
        watched = episode.shown
        trace = watched.trace
        if trace.observations:
            await self._socket.send_bytes(_frame(watched))
        if episode.over:
            end = await self._aside(episode.end)
            trace.end = trace.end or end
            more = "" if self._played is not None else "; save it, or play again"
            await self._tell("over", words=f"{result(trace)}{more}")

    async def _save(self, plan: Plan, subject: Subject) -> None:
        """Send the episode so far as a report for ``envcraft replay``."""
        episode = self._episode
        if episode is None:
            return
        episode.stop()
        trace = await self._aside(episode.finish)
        played = Played()
        check = CheckReport(
            played.name, Verdict.SKIP, findings=list(played.find(subject, trace)), reason="a person plays"
        )
        done = report_on(plan, subject, [check], time.monotonic())
        report = Report(plan.contract.name, plan.seed, [done], budget=plan.budget.name)
        await self._tell("saved", name="episode.json", report=report.to_json().decode())

    def _leave(self) -> None:
        episode, self._episode = self._episode, None
        if episode is not None:
            episode.leave()

    def _close(self, subject: Subject) -> None:
        self._leave()
        subject.close()

    async def _aside(self, call: Callable[[], _T]) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, call)

    async def _tell(self, kind: str, **more: Any) -> None:
        await self._socket.send_text(json.dumps({"kind": kind, **more}))


def _prepare(subject: Subject, person: bool) -> tuple[Keys | None, Conditions]:
    """The keys of an environment for a person, and the conditions under which it shows frames. Raises UsageError."""
    loaded = subject.load()
    if loaded.trace.fault is not None:
        raise UsageError(f"the environment cannot be constructed: {one_line(loaded.trace.fault)}")
    keys = keys_for(subject.contract, subject.action_space) if person else None
    return keys, with_frames(subject, Conditions())


def _read(text: str) -> _Message:
    try:
        return msgspec.json.decode(text, type=_Message)
    except msgspec.DecodeError as error:
        raise UsageError(f"the page sent an invalid message: {error}") from None


def _frame(watched: Watched) -> bytes:
    trace = watched.trace
    picture = pixels(watched.picture) if watched.picture is not None else None
    height, width = picture.shape[:2] if picture is not None else (0, 0)
    info = trace.infos[-1].decode("utf-8", "replace") if trace.infos else ""
    text = json.dumps(
        {
            "reward": _finite(trace.rewards[-1] if trace.rewards else 0.0),
            "total": _finite(trace.total),
            "terminated": bool(trace.terminated and trace.terminated[-1]),
            "truncated": bool(trace.truncated and trace.truncated[-1]),
            "info": one_line(watched.text if picture is None else info)[:_MAX_TEXT],
            "width": width,
            "height": height,
        }
    ).encode()
    return struct.pack(">I", len(text)) + text + (picture.tobytes() if picture is not None else b"")


def _finite(value: float) -> float | str:
    return value if math.isfinite(value) else str(value)
