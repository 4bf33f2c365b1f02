"""A real browser for tests of pages. The timeouts are long, because a page may be slow beside hostile programs."""

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
    """The browser. Skips the test if there is no browser."""
    if _CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    from playwright.sync_api import expect, sync_playwright

    expect.set_options(timeout=_MILLISECONDS)
    with sync_playwright() as playwright:
        # Its sandbox does not work in a container, and the pages are trusted.
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=["--no-sandbox"], timeout=_MILLISECONDS)
        yield browser
        browser.close()


def window(browser: Browser, **options: Any) -> BrowserContext:
    """A new browser context."""
    context = browser.new_context(**options)
    context.set_default_timeout(_MILLISECONDS)
    return context
