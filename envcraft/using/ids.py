"""Data sets that ``envcraft export --to minari`` wrote up to version 0.1 name the entry point
``envcraft.using.ids:create``.
"""

from envcraft.environments.registration import create

__all__ = ["create"]
