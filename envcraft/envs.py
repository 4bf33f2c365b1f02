"""Registers the environments of a corpus with Gymnasium when it is imported, so that
``gymnasium.make("envcraft.envs:EnvCraft/<name>-v0")`` makes them.

The corpus is the one that ENVCRAFT_CORPUS or ``corpus`` in ``[tool.envcraft]`` names; without one, a warning says so.
:func:`envcraft.register` registers any corpus.
"""

from __future__ import annotations

import sys
import warnings

from envcraft.corpus.ids import identifier
from envcraft.environments.registration import create, register
from envcraft.environments.sources import VARIABLE, default_corpus

__all__ = ["create", "identifier", "register"]

if default_corpus() is not None:
    register()
else:
    # Not an error: the importing program may register another corpus next. gymnasium.make imports this module by its
    # name, so that frames of other packages stand between here and the user's line.
    _frame = sys._getframe(1)
    while _frame.f_back and _frame.f_globals.get("__name__", "").partition(".")[0] in ("importlib", "gymnasium"):
        _frame = _frame.f_back
    warnings.warn_explicit(
        f"envcraft.envs registers no environment, because no corpus is named. Set {VARIABLE}, or corpus in "
        "[tool.envcraft] of pyproject.toml, before the import",
        UserWarning,
        _frame.f_code.co_filename,
        _frame.f_lineno,
    )
