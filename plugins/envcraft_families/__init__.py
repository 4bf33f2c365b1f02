"""The families `breakout`, `maze`, `shooter` and `snake`, with a player for each."""
