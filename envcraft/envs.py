"""Importing this registers the environments of the corpus that ENVCRAFT_CORPUS or ``[tool.envcraft] corpus`` names, so
that ``gymnasium.make("envcraft.envs:EnvCraft/<name>-v0")`` finds them; where neither names one, nothing happens.

:func:`envcraft.register` does it for any corpus.
"""

from __future__ import annotations

from envcraft.using.ids import create, identifier, register
from envcraft.using.sources import default_corpus

__all__ = ["create", "identifier", "register"]

if default_corpus() is not None:
    register()
