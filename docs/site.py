"""The hook of MkDocs for ``make site``: pages that are not in ``docs/``, and links that work on the site.

README and the other pages of the repository's root become pages, and so do the guides to the rules. The references for
the command line and for Python are generated. A link to a file without a page becomes the file's name.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import envcraft
from envcraft.cli.group import cli

ROOT = Path(__file__).resolve().parent.parent
#: The page on the site of each page in the repository's root.
ROOT_PAGES = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
}
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!\w+:)([^)\s#]*)(#[^)\s]*)?\)")
_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.DOTALL | re.MULTILINE)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in ``docs/``."""
    for name, page in ROOT_PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / name).read_text("utf-8")))
    for guide in guides():
        content = f"# {guide.stem}\n\n{guide.read_text('utf-8')}"
        files.append(File.generated(config, f"rules/{guide.name}", content=content))
    files.append(File.generated(config, "commands.md", content="\n".join(commands())))
    files.append(File.generated(config, "python.md", content=python()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Make the links of a page lead to pages of the site."""
    origins = {site: name for name, site in sites().items()}
    origin = origins.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    parts = _FENCE.split(markdown)
    return "".join(part if part.lstrip().startswith("```") else linked(part, origin) for part in parts)


def sites() -> dict[str, str]:
    """The page of each file that is not in ``docs/``, by its path in the repository."""
    return ROOT_PAGES | {guide.relative_to(ROOT).as_posix(): f"rules/{guide.name}" for guide in guides()}


def linked(markdown: str, origin: str) -> str:
    """Text of the file `origin` with its links as they work on the site."""
    known = sites()
    here = known.get(origin, origin.removeprefix("docs/"))

    def replace(found: re.Match[str]) -> str:
        image, text, target, anchor = found.groups()
        if not target:
            return found[0]
        path = os.path.normpath(os.path.join(os.path.dirname(origin), target))
        if path in known:
            site = known[path]
        elif path.startswith("docs/") and (ROOT / path).is_file() and not path.endswith(".py"):
            site = path.removeprefix("docs/")
        else:
            return text if "`" in text or text == path else f"{text} (`{path}`)"
        return f"{image}[{text}]({os.path.relpath(site, os.path.dirname(here) or '.')}{anchor or ''})"

    return _LINK.sub(replace, markdown)


def guides() -> list[Path]:
    """The guides to the rules."""
    return sorted(ROOT.glob("*/*/guides/EC*.md"))


def commands() -> Iterator[str]:
    """The page on the command line: the help of each command."""
    yield "# Commands\n"
    yield "The `--help` of every command, built-in plugins included.\n"
    context = click.Context(cli, info_name="envcraft", terminal_width=100, max_content_width=100)
    yield from _helps(cli, context)


def _helps(command: click.Command, context: click.Context) -> Iterator[str]:
    if not isinstance(command, click.Group):
        yield f"## {context.command_path}\n\n```text\n{command.get_help(context)}\n```\n"
        return
    for name in command.list_commands(context):
        below = command.get_command(context, name)
        if below is not None and not below.hidden:
            inner = click.Context(below, info_name=name, parent=context, terminal_width=100, max_content_width=100)
            yield from _helps(below, inner)


def python() -> str:
    """The page on the Python API: each public name, from its docstring."""
    modules: dict[str, Any] = envcraft._MODULES
    names = "\n".join(f"::: envcraft.{module}.{name}\n" for name, module in sorted(modules.items()))
    return f"# Python\n\nEvery name can be imported from `envcraft`.\n\n{names}"
