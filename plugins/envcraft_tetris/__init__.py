"""``envcraft generate --family tetris``: games of falling pieces, each a file of its own."""
