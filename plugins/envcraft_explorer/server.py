"""The server: the pages as files, and beside them live play and replays of findings."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from http import HTTPStatus
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from envcraft.errors import EnvCraftError, UsageError
from envcraft.text import one_line
from envcraft_explorer.guard import Guard
from envcraft_explorer.live import Limits, Session
from envcraft_explorer.recording import of_finding
from envcraft_explorer.stage import MOST, Full, Stage


class Server:
    """The application.

    Args:
        folder: the site, made for a server.
        stage: the environments.
        port: of the server.
        limits: of each session.

    Attributes:
        app: the guarded ASGI application.
    """

    def __init__(self, folder: Path, stage: Stage, port: int, limits: Limits | None = None) -> None:
        self._stage, self._limits = stage, limits or Limits()
        self._names = cache(stage.names)
        # Sessions wait in these threads, and recordings work in them.
        self._threads = ThreadPoolExecutor(MOST + 4, "envcraft-explorer")
        routes = [
            WebSocketRoute("/live/play", self._play),
            Route("/live/players", self._players),
            Route("/live/finding", self._finding),
            Mount("/", StaticFiles(directory=folder, html=True)),
        ]
        self.app = Guard(Starlette(routes=routes), port)

    @property
    def token(self) -> str:
        """The secret of the address."""
        return self.app.token

    def close(self) -> None:
        """End the threads."""
        self._threads.shutdown(cancel_futures=True)

    async def _play(self, socket: WebSocket) -> None:
        await socket.accept()
        await Session(socket, self._stage, self._threads, self._names, self._limits).run()

    async def _players(self, request: Request) -> JSONResponse:
        def players() -> list[list[str]]:
            known = self._stage.players(self._name(request))
            return [[one_line(player.name), one_line(player.summary)] for player in known.values()]

        return await self._answer(players)

    async def _finding(self, request: Request) -> JSONResponse:
        def episode() -> dict[str, Any]:
            name, number = self._name(request), _whole(request.query_params.get("finding", ""))
            found = self._stage.findings(name)
            if not 0 < number <= len(found):
                raise UsageError(f"{one_line(name)} has {len(found)} findings, and no finding {number}")
            with self._stage.place(), self._stage.subject(name) as subject:
                recorded = of_finding(subject, *found[number - 1], number)
            if recorded.picture is None:
                raise UsageError(f"there is no picture to show: {recorded.data['words']}")
            encoded = base64.b64encode(recorded.picture).decode()
            return {**recorded.data, "picture": f"data:image/webp;base64,{encoded}"}

        return await self._answer(episode)

    async def _answer(self, work: Callable[[], Any]) -> JSONResponse:
        try:
            return JSONResponse(await asyncio.get_running_loop().run_in_executor(self._threads, work))
        except Full as error:
            return JSONResponse({"words": one_line(error)}, HTTPStatus.SERVICE_UNAVAILABLE)
        except EnvCraftError as error:
            return JSONResponse({"words": one_line(error)}, HTTPStatus.UNPROCESSABLE_ENTITY)

    def _name(self, request: Request) -> str:
        """The environment of a request: its number, and its name as the page shows it. Raises UsageError."""
        names, given = self._names(), request.query_params
        number = _whole(given.get("number", "-1"))
        if 0 <= number < len(names) and one_line(names[number]) == given.get("environment"):
            return names[number]
        raise UsageError(f"the corpus has no environment {one_line(given.get('environment', ''))}")


def _whole(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise UsageError(f"{one_line(text)} is not a number") from None
