"""``make new-check NAME=...``: write a built-in check with its fixtures, and register it.

The check is a copy of :mod:`evaluation.example_check`, and the fixtures are copies of the game that ``envcraft new``
writes. All of it passes the tests as written, so that an author starts from a rule that works.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import click

from envcraft.judging.check import Check
from envcraft.plugins import plugins

ROOT = Path(__file__).resolve().parent.parent
_EXAMPLE = Path(__file__).with_name("example_check.py")
_GAME = ROOT / "envcraft" / "templates" / "arcade" / "new_game.py"
_INFO = '"lamps": LAMPS - len(self.lamps)}'
#: Values of ``info[NAME]``, by the name of the fixture.
_BAD = {
    "always": "True",
    "after_reset": "self.steps > 0",
    "every_other_step": "self.steps % 2 == 1",
    "after_three_steps": "self.steps >= 3",
    "before_the_first_lamp": "len(self.lamps) == LAMPS",
}
_GOOD = {
    "false": ("False", "info has the key, and its value is False"),
    "number": ("self.steps", "info has the key, and its value is a number"),
    "text": ('"True"', "info has the key, and its value is a string"),
}
_GUIDE = """## Why is this bad?
Replace this guide by your own, and say here what the defect does to training.

## Example
```python
{example}```

## How it is detected
`info["{name}"]` is compared with True at every step of every episode.

## What it misses
A mark in a state that no play reaches.
"""
#: Every check comes before ``sandbox``, which judges what happened during the others.
_LAST = '    "envcraft_checks.sandbox": ("envcraft_checks",),\n'


def create(name: str, root: Path = ROOT) -> list[Path]:
    """Write a check, the guide of its rule, five bad and three good fixtures, and the line that registers the check.

    Args:
        name: the check's name, a lower-case Python identifier.
        root: the repository.

    Returns:
        The files that were written, the check first.

    Raises:
        ValueError: the name is not valid, or taken.
    """
    checks: list[Check] = plugins().collect("envcraft_checks")
    module = root / "checks" / "envcraft_checks" / f"{name}.py"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"{name!r} is not a lower-case Python identifier")
    if module.exists() or name in {check.name for check in checks}:
        raise ValueError(f"there is a check {name} already")
    code = free_code({rule.code for check in checks for rule in check.rules})
    written = {module: _renamed(_EXAMPLE.read_text("utf-8"), name).replace("EC000", code)}
    game = _GAME.read_text("utf-8")
    guide = _GUIDE.format(name=name, example=_with_info(game, name, _BAD["always"]))
    written[module.parent / "guides" / f"{code}.md"] = guide
    fixtures = root / "tests" / "fixtures" / name
    for variant, value in _BAD.items():
        path = fixtures / "bad" / f"{code.lower()}_{variant}.py"
        written[path] = f"# expect: {code}\n{_with_info(game, name, value)}"
    for variant, (value, words) in _GOOD.items():
        written[fixtures / "good" / f"{variant}.py"] = f"# near-miss: {words}.\n{_with_info(game, name, value)}"
    registry = root / "envcraft" / "plugins.py"
    line = f'    "envcraft_checks.{name}": ("envcraft_checks",),\n'
    written[registry] = registry.read_text("utf-8").replace(_LAST, line + _LAST)
    for path, text in written.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    return list(written)


def free_code(taken: set[str]) -> str:
    """The first code of a decade in which no code is taken; EC05x belongs to the check ``lint``."""
    decades = {code[:-1] for code in taken} | {"EC05"}
    return next(f"EC{decade:02}1" for decade in range(100) if f"EC{decade:02}" not in decades)


def _renamed(text: str, name: str) -> str:
    return (
        text.replace("Example()", f"{_class(name)}()")
        .replace("class Example", f"class {_class(name)}")
        .replace("example", name)
    )


def _class(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def _with_info(game: str, name: str, value: str) -> str:
    return game.replace(_INFO, f'{_INFO[:-1]}, "{name}": {value}}}')


def main() -> int:
    """Write the check that the command line names."""
    try:
        (name,) = sys.argv[1:]
        for path in create(name):
            click.echo(f"wrote {path.relative_to(ROOT)}")
    except ValueError as error:
        click.echo(f"make new-check NAME=...: {error}", err=True)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
