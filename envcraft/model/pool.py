"""The pools that concepts are combined from, as far as a report on a corpus needs them."""

from __future__ import annotations

from typing import NamedTuple


class Pool(NamedTuple):
    """A pool of ingredients.

    Attributes:
        name: The kind of its ingredients, such as ``theme`` in ``theme:coral-reef``.
        entries: The names of its ingredients.
    """

    name: str
    entries: tuple[str, ...]
