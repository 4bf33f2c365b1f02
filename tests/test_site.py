"""The site: it builds without a warning or the network, its links lead somewhere, and the tutorial's commands run."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import envcraft
from envcraft.plugins import plugins


class Page(HTMLParser):
    """What a page loads, what it links to, and its anchors."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.loaded: set[str] = set()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if identifier := given.get("id"):
            self.anchors.add(identifier)
        if tag in {"script", "img"} and given.get("src"):
            self.loaded.add(str(given["src"]))
        if tag == "link" and given.get("rel") in {"stylesheet", "icon", "preload"}:
            self.loaded.add(str(given["href"]))
        if tag == "a" and given.get("href"):
            self.links.add(str(given["href"]))


@pytest.fixture(scope="module")
def site(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    # A proxy that refuses: a build that asks another server fails.
    variables = os.environ | dict.fromkeys(("http_proxy", "https_proxy"), "http://127.0.0.1:9")
    variables |= {"PYTHONDONTWRITEBYTECODE": "1"}
    result = subprocess.run(command, cwd=root, env=variables, capture_output=True, text=True, timeout=240, check=False)
    assert result.returncode == 0, result.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in site.rglob("*.html")}


def test_pages_load_nothing_from_another_server(pages: dict[Path, Page]) -> None:
    loaded = {source for page in pages.values() for source in page.loaded}
    assert loaded
    assert not [source for source in loaded if source.startswith(("http:", "https:", "//"))]


def test_links_lead_to_pages_and_anchors(site: Path, pages: dict[Path, Page]) -> None:
    broken = []
    for path, page in pages.items():
        for link in page.links:
            if re.match(r"\w+:", link) or path.name == "404.html":
                continue
            target, _, anchor = link.partition("#")
            file = (path.parent / target).resolve() if target else path
            if not file.exists() or (anchor and file in pages and anchor not in pages[file].anchors):
                broken.append(f"{path.relative_to(site)}: {link}")
    assert not broken


def test_the_reference_has_every_rule_command_and_public_name(site: Path, pages: dict[Path, Page]) -> None:
    codes = {rule.code for check in plugins().collect("envcraft_checks") for rule in check.rules}
    text = "".join(path.read_text("utf-8") for path in (site / "rules").glob("*.html"))
    assert not [code for code in codes if code not in text]
    commands = (site / "commands.html").read_text("utf-8")
    assert not [each.name for each in plugins().collect("envcraft_commands") if f"envcraft {each.name}" not in commands]
    modules = envcraft._MODULES
    assert {f"envcraft.{modules[name]}.{name}" for name in modules} <= pages[site / "python.html"].anchors


def test_the_search_index_has_the_pages(site: Path) -> None:
    index = (site / "search" / "search_index.json").read_text("utf-8")
    assert "PYTHONHASHSEED" in index
    assert "tutorial.html" in index


def test_every_command_of_the_tutorial_runs(root: Path, tmp_path: Path) -> None:
    """In order and in one folder. Its edits apply; a comment gives the exit status where it is not 0."""
    (tmp_path / "pyproject.toml").write_text('[tool.envcraft]\nsandbox = "process"\nbudget = "quick"\n')
    text = (root / "docs" / "tutorial.md").read_text("utf-8")
    game = tmp_path / "lantern.py"
    ran = 0
    for kind, code in re.findall(r"^```(console|diff)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if kind == "diff":
            before, after = (line[1:] for line in code.splitlines())
            assert before in game.read_text("utf-8").splitlines()
            game.write_text(game.read_text("utf-8").replace(before, after))
            continue
        for line in code.splitlines():
            program, *words = shlex.split(line, comments=True)
            if program == "pip":
                continue
            status = re.search(r"# exits with (\d)", line)
            result = subprocess.run(
                [sys.executable, "-m", program, *words],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                timeout=240,
                check=False,
            )
            assert result.returncode == int(status[1] if status else 0), f"{line}\n{result.stdout}{result.stderr}"
            ran += 1
    assert ran >= 10
