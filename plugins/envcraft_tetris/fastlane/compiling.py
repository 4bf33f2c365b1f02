"""How the simulator's functions are compiled."""

from __future__ import annotations

from typing import Any

from envcraft.errors import UsageError

try:
    import numba
except ImportError:
    raise UsageError("the fast lane needs numba: pip install 'envcraft-rl[train]'") from None

#: For functions that only compiled ones call: wrappers for other callers would take longer to compile than they do.
#: Nothing is divided by zero, and nothing looks out for it. The compiler copies what is called into each place that
#: calls it, so that the larger functions are called in one place alone.
_LEAN: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
jit: Any = numba.njit(**_LEAN)


def entry(function: Any) -> Any:
    """For functions that Python calls: their machine code is kept on disk where there is a place for it."""
    try:
        return numba.njit(error_model="numpy", nogil=True, cache=True)(function)
    except RuntimeError:
        return numba.njit(error_model="numpy", nogil=True)(function)
