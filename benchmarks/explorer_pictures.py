"""``make pictures``: take the screenshots of the explorer, on the examples and some variants of Tetris."""

from __future__ import annotations

import contextlib
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from envcraft.cli.group import cli
from envcraft.errors import UsageError
from envcraft.judging.selection import driver_named
from evaluation.explorer import Served, served
from evaluation.fixtures import ROOT

DOCS = ROOT / "docs"
_VARIANTS = "8"
_COLOURS = 128


def corpus(folder: Path) -> Path:
    """Judge the examples and the variants in a new corpus."""
    root = folder / "games"
    for arguments in (
        ["corpus", "init", str(root)],
        ["corpus", "add", str(root), str(ROOT / "examples")],
        ["generate", "--family", "tetris", "--count", _VARIANTS, "--corpus", str(root)],
        ["audit", str(root), "--budget", "quick"],
    ):
        result = CliRunner().invoke(cli, arguments)
        if result.exit_code not in (0, 1):
            raise UsageError(f"envcraft {' '.join(arguments)} failed: {result.output}")
    return root


def shoot(browser: Any, server: Served) -> None:
    """Take the pictures."""
    page = browser.new_page(viewport={"width": 1100, "height": 760})
    page.goto(server.entry)
    _save(page, "corpus")
    page.goto(f"{server.address}/environments.html")
    page.wait_for_selector("#rows img.film")
    _save(page, "gallery")
    page.locator("#rows a", has_text="snake").first.click()
    controls = page.locator("#part-play .controls")
    controls.get_by_role("button", name="Pause").click()
    controls.get_by_role("button", name="Play").click()
    page.wait_for_selector("#part-play .large[data-frames='1']")
    for number, key in enumerate(["ArrowDown"] * 6 + ["ArrowRight"] * 6, 2):
        page.keyboard.press(key)
        page.wait_for_selector(f"#part-play .large[data-frames='{number}']")
    page.locator("#part-play").evaluate("part => part.scrollIntoView()")
    _save(page, "play")
    page.goto(f"{server.address}/environments.html#environment=tetris_0_0003.py")
    page.wait_for_selector("#part-watch .players[data-ready]")
    for player in ("random", "noop", "tetris"):
        page.locator("#part-watch .players").get_by_role("button", name=player, exact=True).click()
    page.wait_for_function(
        "() => [...document.querySelectorAll('#part-watch .large')].filter(one => one.dataset.frames > 40).length > 2"
    )
    page.locator("#part-watch").evaluate("part => part.scrollIntoView()")
    _save(page, "watch")


def _save(page: Any, name: str) -> None:
    from PIL import Image

    page.wait_for_function(
        "() => [...document.images].every(one => one.complete || one.getBoundingClientRect().top > innerHeight)"
    )
    path = DOCS / f"explorer-{name}.png"
    page.screenshot(path=path)
    # A palette is a third of the size.
    Image.open(path).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"wrote {path.relative_to(ROOT)}: {path.stat().st_size:,} bytes")


def main() -> int:
    chromium = shutil.which("chromium")
    if chromium is None:
        print("there is no chromium on this machine: apt-get install chromium", file=sys.stderr)
        return 1
    from playwright.sync_api import sync_playwright

    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        driver = stack.enter_context(contextlib.closing(driver_named("auto")))
        root = corpus(folder)
        server = stack.enter_context(served(root, folder / "pages", driver))
        playwright = stack.enter_context(sync_playwright())
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        stack.callback(browser.close)
        shoot(browser, server)
    return 0


if __name__ == "__main__":
    sys.exit(main())
