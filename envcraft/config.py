"""``[tool.envcraft]`` of the nearest ``pyproject.toml``."""

from __future__ import annotations

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
        text = path.read_text("utf-8")
        if "envcraft" not in text:
            return path, {}
        # The parser is slow to import, and most projects have nothing to configure.
        import tomllib

        table = tomllib.loads(text).get("tool", {}).get("envcraft", {})
    except (OSError, ValueError, AttributeError) as error:
        raise UsageError(f"{path} cannot be read as configuration: {error}") from None
    if not isinstance(table, dict):
        raise UsageError(f"{path}: [tool.envcraft] must be a table")
    return path, table
