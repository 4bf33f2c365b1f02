"""Built-in contracts, custom contracts of ``pyproject.toml``, and look-up by name."""
