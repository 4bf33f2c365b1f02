"""EnvCraft: validation-first tools for generated Gymnasium environments.

Importing the package costs nothing: :func:`make`, :func:`make_vec`, :func:`names` and :func:`register` are imported
when they are used.
"""

from __future__ import annotations

# Importing typing takes time in which Ctrl-C is a traceback.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from envcraft.using.ids import register
    from envcraft.using.making import make
    from envcraft.using.sources import names
    from envcraft.using.vector import make_vec

__all__ = ["__version__", "make", "make_vec", "names", "register"]
__version__ = "0.1.0"

_LATE = {
    "make": "envcraft.using.making",
    "make_vec": "envcraft.using.vector",
    "names": "envcraft.using.sources",
    "register": "envcraft.using.ids",
}


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module 'envcraft' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_LATE[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATE})
