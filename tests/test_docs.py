"""What is generated is up to date, and what the documentation names exists."""

from __future__ import annotations

import ast
import html
import importlib
import importlib.util
import inspect
import json
import re
import shlex
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest

from envcraft import hookspecs
from envcraft.contracts.custom import custom_contracts
from envcraft.plugins import plugins

ROOT = Path(__file__).resolve().parent.parent
PAGES = [
    ROOT / "README.md",
    *(ROOT / name for name in ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")),
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "docs" / "rules" / "index.md",
    ROOT / "tests" / "plugin_package" / "README.md",
]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
#: Where the classes live that the text names without their module.
HOMES = {
    "Subject": "envcraft.judging.subject",
    "Trace": "envcraft.model.trace",
    "Check": "envcraft.judging.check",
    "Driver": "envcraft.judging.driver",
    "Worker": "envcraft.judging.driver",
    "Rollout": "envcraft.model.rollout",
}


def test_rule_pages_and_table_are_up_to_date(root: Path) -> None:
    command = [sys.executable, "-m", "docs.generate", "--check"]
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=240, check=False)
    assert result.returncode == 0, result.stderr


def test_the_readme_takes_two_screens(root: Path) -> None:
    assert len((root / "README.md").read_text("utf-8").splitlines()) <= 105


def test_the_recording_shows_the_five_first_commands_with_their_seconds(root: Path) -> None:
    assert "(docs/first-commands.svg)" in (root / "README.md").read_text("utf-8")
    rows: dict[float, list[tuple[float, str]]] = {}
    texts = re.findall(r'<text[^>]* x="([\d.]+)" y="([\d.]+)"[^>]*>(.*?)</text>', recording(root), re.DOTALL)
    for x, y, words in texts:
        rows.setdefault(float(y), []).append((float(x), html.unescape(words).replace("\xa0", " ")))
    lines = ["".join(words for _, words in sorted(rows[y])).strip() for y in sorted(rows)]
    shown = [line.removeprefix("$ ").partition(" #")[0].strip() for line in lines if line.startswith("$ ")]
    assert shown == [
        "envcraft validate lantern.py",
        "envcraft validate games/",
        "envcraft validate gymnasium:CartPole-v1 --contract gymnasium",
        "python cell.py",
        "pytest --envcraft games/ -q",
    ]
    assert len([line for line in lines if re.fullmatch(r"\d+\.\d s", line)]) == len(shown)
    assert len([line for line in lines if " passed, 0 failed, " in line]) == len(shown)


def recording(root: Path) -> str:
    return (root / "docs" / "first-commands.svg").read_text("utf-8")


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", prose(page))
    assert not [link for link, _ in links if not (page.parent / link).exists()]
    pages = {link: page.parent / link if link else page for link, anchor in links if anchor}
    assert not [(link, anchor) for link, anchor in links if anchor and anchor not in anchors(pages[link])]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_code_that_names_a_file_is_in_that_file(page: Path) -> None:
    for name, code in re.findall(r"<!-- (\S+) -->\n```\w*\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
        assert code in (ROOT / name).read_text("utf-8"), f"not in {name}:\n{code}"


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_code_can_be_read_by_what_it_is_for(page: Path, tmp_path: Path) -> None:
    for kind, code in fences(page):
        if kind == "python":
            compile(textwrap.dedent(code), page.name, "exec", ast.PyCF_ONLY_AST)
        elif kind == "json":
            json.loads(code)
        elif kind == "toml":
            (tmp_path / "pyproject.toml").write_text(code)
            assert tomllib.loads(code)
            custom_contracts(tmp_path, plugins().collect("envcraft_contracts"))


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_command_lines_name_commands_options_and_files_that_there_are(page: Path) -> None:
    known = {command.name: command for command in plugins().collect("envcraft_commands")}
    told = "\n".join(code for kind, code in fences(page) if kind == "console").splitlines()
    told += re.findall(r"`((?:envcraft|python -m) [^`\n]+)`", prose(page))
    for line in told:
        words = shlex.split(line, comments=True)
        assert not [word for word in words if word.startswith("tests/") and not (ROOT / word).exists()], line
        if "-m" in words and words[(at := words.index("-m")) + 1].startswith(("benchmarks.", "tests.")):
            assert importlib.util.find_spec(words[at + 1]), line
        if words[:1] != ["envcraft"]:
            continue
        if words[1] == "census":
            # The worked plugin's, which tests/e2e runs.
            continue
        if words[1].startswith("-"):
            continue
        assert words[1] in known, line
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert options <= set(options_of(known[words[1]])), line


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_names_in_the_text_exist(page: Path) -> None:
    hooks = hooks_there_are()
    for name in re.findall(
        r"`((?:envcraft|Subject|Trace|Check|Driver|Worker|Rollout)(?:[._]\w+)+)(?:\(\))?`", prose(page)
    ):
        if name not in hooks:
            assert exists(name), name


def test_every_hook_is_in_the_table(root: Path) -> None:
    rows = re.findall(r"^\| `(envcraft_\w+)` \|", (root / "docs" / "plugins.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(rows) == sorted(hooks_there_are())


def hooks_there_are() -> set[str]:
    return {name for name, spec in vars(hookspecs).items() if hasattr(spec, "envcraft_spec")}


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and MkDocs write them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def fences(page: Path) -> list[tuple[str, str]]:
    """A page's blocks of code: the language of each, and the text."""
    return re.findall(r"^```(\w+)\n(.*?)^```", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)


def options_of(command: click.Command) -> Iterator[str]:
    """The options of a command and of those below it."""
    for parameter in command.params:
        yield from [*parameter.opts, *parameter.secondary_opts]
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from options_of(below)


def exists(name: str) -> bool:
    """Whether a dotted name leads to something: a module, or what is in one, fields of classes included."""
    first, *rest = name.split(".")
    if first in HOMES:
        rest = [*HOMES[first].split("."), first, *rest]
        first = rest.pop(0)
    found: Any = importlib.import_module(first)
    for part in rest:
        if (
            not hasattr(found, part)
            and inspect.ismodule(found)
            and importlib.util.find_spec(f"{found.__name__}.{part}")
        ):
            importlib.import_module(f"{found.__name__}.{part}")
        if hasattr(found, part):
            found = getattr(found, part)
        elif part not in getattr(found, "__annotations__", ()):
            return False
    return True


def test_codes_are_unique_and_every_rule_says_how_to_mend_it() -> None:
    rules = [rule for check in plugins().collect("envcraft_checks") for rule in check.rules]
    assert len({rule.code for rule in rules}) == len({rule.name for rule in rules}) == len(rules)
    assert all(re.fullmatch(r"EC\d{3}", rule.code) for rule in rules)
    assert all(rule.summary.endswith(".") and rule.fix.endswith(".") for rule in rules)
