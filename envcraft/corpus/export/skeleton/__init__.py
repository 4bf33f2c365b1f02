"""Gymnasium environments that EnvCraft validated. Importing this package registers them and imports none of them."""

from __future__ import annotations

from ._making import ENVIRONMENTS, create, register

__all__ = ["ENVIRONMENTS", "create", "register"]

register()
