"""Validation from Python: what ``envcraft.validate`` and ``envcraft.check_env`` do, and what they return."""
