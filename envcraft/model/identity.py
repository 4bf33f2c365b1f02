"""The identity of a finding across runs."""

from __future__ import annotations

import os
from urllib.parse import quote

from envcraft.text import relative


def fingerprint(path: str, code: str, nth: int) -> str:
    """Identify a finding across runs.

    Args:
        path: the subject's path.
        code: the finding's code.
        nth: the index among the subject's findings of this code, from 0.

    Returns:
        A SHA-256 as hex. Lines and measured values are left out, because they change with each edit.
    """
    identity = "\0".join((quote(os.fsencode(relative(path))), code, str(nth)))
    # Slow to import, and needed only for a finding.
    import hashlib

    return hashlib.sha256(identity.encode("utf-8", "backslashreplace")).hexdigest()
