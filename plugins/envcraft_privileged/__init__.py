"""Players for ``envcraft demos``, and that command."""
