"""A real browser for tests of pages, with patience: beside hostile programs a page may take long."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext

_CHROMIUM = shutil.which("chromium")
_MILLISECONDS = 120_000


@contextmanager
def chromium() -> Iterator[Browser]:
    """The browser, or a skip where there is none."""
    if _CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        # Its own sandbox needs more than a container gives; the pages are ours.
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=["--no-sandbox"], timeout=_MILLISECONDS)
        yield browser
        browser.close()


def window(browser: Browser, **options: Any) -> BrowserContext:
    """A window of its own."""
    context = browser.new_context(**options)
    context.set_default_timeout(_MILLISECONDS)
    return context
