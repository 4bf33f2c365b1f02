"""``python -m benchmarks.explorer``: the explorer's first page, the way from a key to a frame, and players at once.

A Chromium opens the gallery of 10,000 environments, made as ``benchmarks.audit_report`` makes them, and searches it.
Then it plays a game by keyboard, and measures in the page the time from a key to the picture that shows its effect:
paused, where each key is a step, and while the game runs at 30 steps per second, where a key waits for the next step.
Last, 20 connections play at once for some seconds, and one more asks for a place.

The exit status is 1 if a limit is broken: on the time until the first page is interactive, on the time from a key to
its frame while paused, or on the number of players.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import shutil
import struct
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.audit_report import fill
from envcraft.corpus.store import Store
from envcraft.judging.selection import driver_named
from evaluation.explorer import GAME, Served, served

SIZE, PLAYERS, KEYS, SECONDS = 10_000, 20, 100, 5.0
FIRST_PAGE, LATENCY = 1.0, 0.05
_RATE = 30
#: From a key to the change of the text that shows the position, in milliseconds.
_PRESS = """key => new Promise(resolve => {
    const screen = document.querySelector("#part-play .large"), shown = document.querySelector("#part-play .flags");
    const started = performance.now();
    const watching = new MutationObserver(() => { watching.disconnect(); resolve(performance.now() - started); });
    watching.observe(shown, { childList: true, characterData: true, subtree: true });
    screen.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
    screen.dispatchEvent(new KeyboardEvent("keyup", { key, bubbles: true }));
})"""


def first_page(page: Any, server: Served, size: int) -> tuple[float, float]:
    """Seconds until the gallery can be used, and until a search of all sources has its result."""
    page.goto(server.entry)
    started = time.perf_counter()
    page.goto(f"{server.address}/environments.html")
    page.wait_for_selector("#rows[aria-busy=false] li")
    opened = time.perf_counter() - started
    started = time.perf_counter()
    page.locator("#query").fill("gymnasium")
    page.get_by_text(f"of {size:,}").first.wait_for()
    return opened, time.perf_counter() - started


def latencies(page: Any, server: Served) -> dict[str, list[float]]:
    """Seconds from each key to its frame, paused and running."""
    page.goto(server.entry)
    page.goto(f"{server.address}/environments.html#environment=walk.py")
    controls = page.locator("#part-play .controls")
    controls.get_by_role("button", name="Pause").click()
    controls.get_by_role("button", name="Play").click()
    page.wait_for_selector("#part-play .large[data-frames='1']")
    found = {"paused": [page.evaluate(_PRESS, "ArrowRight") / 1e3 for _ in range(KEYS)]}
    controls.get_by_role("button", name="Continue").click()
    found["running"] = [page.evaluate(_PRESS, "ArrowRight") / 1e3 for _ in range(KEYS)]
    return found


async def crowd(server: Served) -> tuple[int, float, str]:
    """How many play at once, the slowest one's steps per second, and the refusal that the next one receives."""
    from websockets.asyncio.client import connect

    cookie = {"Cookie": f"envcraft-{server.port}={server.token}"}
    address = f"ws://127.0.0.1:{server.port}/live/play"
    async with contextlib.AsyncExitStack() as stack:
        sockets = []
        for _ in range(PLAYERS + 1):
            socket = await stack.enter_async_context(connect(address, additional_headers=cookie))
            await socket.send(json.dumps({"environment": "walk.py", "number": 0, "on": True}))
            sockets.append((socket, json.loads(await socket.recv())))
        ready = [socket for socket, told in sockets if told["kind"] == "ready"]
        refused = next((told["words"] for _, told in sockets if told["kind"] == "refused"), "")
        # Paused until all are open: nobody reads what comes before.
        for socket in ready:
            await socket.send(json.dumps({"do": "pause", "on": False}))
        counts = await asyncio.gather(*(_frames(socket) for socket in ready))
    return len(ready), min(counts) / SECONDS, refused


async def _frames(socket: Any) -> int:
    """The frames that arrive in some seconds."""
    count = 0
    # What has come before does not count.
    with contextlib.suppress(TimeoutError):
        while True:
            await asyncio.wait_for(socket.recv(), 0.001)
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(SECONDS):
            while True:
                data = await socket.recv()
                count += isinstance(data, bytes) and struct.unpack(">I", data[:4])[0] > 0
    return count


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.explorer", description=__doc__)
    parser.add_argument("--size", type=int, default=SIZE, help="environments in the gallery")
    size: int = parser.parse_args(arguments).size
    chromium = shutil.which("chromium")
    if chromium is None:
        print("left out: there is no chromium on this machine (apt-get install chromium)", file=sys.stderr)
        return 0
    from playwright.sync_api import sync_playwright

    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        driver = stack.enter_context(contextlib.closing(driver_named("process")))
        fill(folder / "many", size)
        with Store.create(folder / "one") as store:
            store.add("walk.py", GAME.format(words="walks", crash=-1).encode())
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        stack.callback(browser.close)
        with served(folder / "many", folder / "pages", driver, previews=False) as server:
            opened, searched = first_page(browser.new_page(viewport={"width": 1280, "height": 800}), server, size)
        with served(folder / "one", folder / "page", driver) as server:
            keys = latencies(browser.new_page(), server)
            browser.close()
            players, rate, refused = _in_thread(server)
    table = Table("", "measured", "limit", box=None)
    table.add_row(f"first page of {size:,} environments", f"{opened:.2f} s", f"{FIRST_PAGE:g} s")
    table.add_row("search of all their sources", f"{searched:.2f} s", "")
    for name, values in keys.items():
        middle, late = (1e3 * float(np.quantile(values, share)) for share in (0.5, 0.95))
        limit = f"{1e3 * LATENCY:g} ms" if name == "paused" else ""
        table.add_row(f"key to frame, {name}: median, 95%", f"{middle:.0f} ms, {late:.0f} ms", limit)
    table.add_row("players at once", f"{players}, each at {rate:.0f} of {_RATE} steps/s or more", str(PLAYERS))
    table.add_row("the next one", refused or "plays", "is refused")
    Console(width=120).print(table)
    late = float(np.quantile(keys["paused"], 0.95))
    return int(opened > FIRST_PAGE or late > LATENCY or players != PLAYERS or not refused)


def _in_thread(server: Served) -> tuple[int, float, str]:
    """Run :func:`crowd` beside the event loop that playwright has in this thread."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(lambda: asyncio.run(crowd(server))).result()


if __name__ == "__main__":
    sys.exit(main())
