"""Importing this registers the environments of the corpus that ENVCRAFT_CORPUS or ``[tool.envcraft] corpus`` names, so
that ``gymnasium.make("envcraft.envs:EnvCraft/<name>-v0")`` finds them; where neither names one, it warns.

:func:`envcraft.register` does it for any corpus.
"""

from __future__ import annotations

import warnings

from envcraft.using.ids import create, identifier, register
from envcraft.using.sources import VARIABLE, default_corpus

__all__ = ["create", "identifier", "register"]

if default_corpus() is not None:
    register()
else:
    # No error, since who imports this may register another corpus next.
    warnings.warn(
        f"envcraft.envs registers no environment: no corpus is named. Set {VARIABLE}, or corpus in [tool.envcraft] of "
        "pyproject.toml, before it is imported",
        stacklevel=2,
    )
