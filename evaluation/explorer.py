"""A server of ``envcraft explore`` in a thread, for tests and benchmarks, and a small game to play in it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from envcraft.contracts.lookup import contract_named
from envcraft.corpus.report.write import write_report
from envcraft.corpus.store import Store
from envcraft.judging.driver import Driver

if TYPE_CHECKING:
    from envcraft_explorer.live import Limits

#: A block walks with the arrows; `words` are in its source and info, and at the position `crash` it raises.
GAME = '''"""A walker. {words}"""
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Walk(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.steps = 0
        return self.render(), {{}}

    def step(self, action):
        self.steps += 1
        self.x = (self.x + {{3: -1, 4: 1}}.get(int(action[0]), 0)) % 84
        if self.x == {crash}:
            raise RuntimeError({words!r})
        return self.render(), float(self.x == 80), False, self.steps >= 1000, {{"words": {words!r}, "x": self.x}}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[40:50, max(self.x - 3, 0) : self.x + 4] = (240, self.x * 3, 40)
        return frame
'''


@dataclass
class Served:
    """A running server: its address without the token, the token, and its port."""

    address: str
    token: str
    port: int

    @property
    def entry(self) -> str:
        """The address that the command prints."""
        return f"{self.address}/?token={self.token}"


@contextmanager
def served(
    root: Path,
    folder: Path,
    driver: Driver,
    most: int = 20,
    previews: bool = True,
    limits: Limits | None = None,
) -> Iterator[Served]:
    """Serve a corpus from a thread.

    Args:
        root: the corpus.
        folder: for the pages; it does not exist yet.
        driver: the sandbox.
        most: how many environments are open at a time.
        previews: whether to make missing previews.
        limits: of each session; those of the command by default.
    """
    import uvicorn
    from envcraft_explorer.server import Server
    from envcraft_explorer.stage import Stage

    contract = contract_named("arcade")
    with Store(root, write=True) as store:
        write_report(store, folder, "", contract, driver if previews else None, live=True)
        root = store.root
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        server = Server(folder, Stage(root, "", driver, contract.name, most), port, limits)
        config = uvicorn.Config(server.app, log_level="warning", lifespan="off", timeout_graceful_shutdown=2)
        running = uvicorn.Server(config)
        thread = threading.Thread(target=running.run, args=([listening],))
        thread.start()
        try:
            yield Served(f"http://127.0.0.1:{port}", server.token, port)
        finally:
            running.should_exit = True
            thread.join()
            server.close()
