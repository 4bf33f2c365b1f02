"""The family `tetris`: a generator of falling-piece games, their vectorized simulator, and a player for them."""
