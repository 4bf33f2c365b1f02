"""The parquet files of a data set's splits, named as the Hugging Face Hub expects.

Rows are written in groups of limited size, and only one group is in memory. The same rows give the same files with the
same version of pyarrow.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyarrow

#: The share of each split, by its name on the Hub.
SPLITS = {"train": 0.8, "validation": 0.1, "test": 0.1}
#: Rows and bytes of text after which a row group is written, and bytes of text after which a new file is started.
_ROWS, _GROUP, _FILE = 500, 8 * 1024**2, 256 * 1024**2


class Shards:
    """Writes the parquet files of all splits. Use it as a context manager.

    Args:
        folder: is created with the first row.
        schema: of the rows.
    """

    def __init__(self, folder: Path, schema: pyarrow.Schema) -> None:
        self._splits = {name: _Split(folder, name, schema) for name in SPLITS}

    def __enter__(self) -> Shards:
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        for split in self._splits.values():
            split.close(whole=kind is None)

    def add(self, split: str, row: dict[str, Any]) -> None:
        self._splits[split].add(row)


class _Split:
    """Writes the parquet files of one split. A split without rows has no files."""

    def __init__(self, folder: Path, name: str, schema: pyarrow.Schema) -> None:
        self._folder, self._name, self._schema = folder, name, schema
        self._rows: list[dict[str, Any]] = []
        self._waiting = self._written = 0
        self._paths: list[Path] = []
        self._writer: Any = None

    def add(self, row: dict[str, Any]) -> None:
        self._rows.append(row)
        self._waiting += _size(row)
        if len(self._rows) >= _ROWS or self._waiting >= _GROUP:
            self._flush()

    def close(self, whole: bool) -> None:
        """Close the files. If `whole`, write the last rows first. Then rename the files, whose number is now known."""
        if whole:
            self._flush()
        if self._writer is not None:
            self._writer.close()
        for number, path in enumerate(self._paths):
            path.rename(self._folder / f"{self._name}-{number:05}-of-{len(self._paths):05}.parquet")

    def _flush(self) -> None:
        import pyarrow
        from pyarrow import parquet

        if not self._rows:
            return
        if self._writer is not None and self._written >= _FILE:
            self._writer.close()
            self._writer, self._written = None, 0
        if self._writer is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._paths.append(self._folder / f"{self._name}-{len(self._paths)}.part")
            self._writer = parquet.ParquetWriter(self._paths[-1], self._schema, compression="zstd")
        self._writer.write_table(pyarrow.Table.from_pylist(self._rows, self._schema))
        self._written += self._waiting
        self._waiting = 0
        self._rows.clear()


def _size(value: Any) -> int:
    """Return the number of characters of all strings in plain data, without the names of fields."""
    if isinstance(value, str):
        return len(value)
    if isinstance(value, dict):
        return sum(map(_size, value.values()))
    return sum(map(_size, value)) if isinstance(value, list) else 0
