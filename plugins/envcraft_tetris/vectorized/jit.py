"""Decorators that compile the functions of the simulator with numba."""

from __future__ import annotations

from typing import Any

from envcraft.errors import UsageError

try:
    import numba
except ImportError:
    raise UsageError("the vectorized simulator needs numba: pip install 'envcraft-rl[train]'") from None

#: Options for functions that only compiled functions call. Wrappers for Python callers take longer to compile than the
#: functions themselves. No divisor is zero, so the checks are off. The compiler inlines at every call site; larger
#: functions therefore have a single call site.
_LEAN: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
jit: Any = numba.njit(**_LEAN)


def entry(function: Any) -> Any:
    """Compile a function that Python calls. Its machine code is cached on disk if the disk is writable."""
    try:
        return numba.njit(error_model="numpy", nogil=True, cache=True)(function)
    except RuntimeError:
        return numba.njit(error_model="numpy", nogil=True)(function)
