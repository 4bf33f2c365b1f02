"""``[tool.envcraft]`` of the nearest ``pyproject.toml``."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from envcraft.errors import UsageError


def settings(folder: Path) -> tuple[Path, dict[str, Any]]:
    """Read the table in `folder` or the nearest folder above; give the file and the table, or {}. Raises UsageError."""
    for parent in (folder, *folder.parents):
        path = parent / "pyproject.toml"
        if path.is_file():
            break
    else:
        return folder / "pyproject.toml", {}
    try:
        table = _table(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read as configuration: {error}") from None
    if not isinstance(table, dict):
        raise UsageError(f"{path}: [tool.envcraft] must be a table")
    return path, table


@functools.lru_cache(maxsize=4)
def _table(text: str) -> Any:
    """The table in a text. One that is no TOML is an error, as for pytest and ruff, if it has no such table, too.

    Raises:
        ValueError: the text is no TOML, or `tool` is no table.
    """
    # The parser is slow to import.
    import tomllib

    tools = tomllib.loads(text).get("tool", {})
    if not isinstance(tools, dict):
        raise ValueError("[tool] must be a table")
    return tools.get("envcraft", {})
