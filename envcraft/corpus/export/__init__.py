"""The formats of ``envcraft export``: one module and one plugin each."""
