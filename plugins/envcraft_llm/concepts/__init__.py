"""The first stage: ideas for games, put together from curated pools. No model is asked.

:mod:`.pools` has the pools, :mod:`.strategies` draws ingredients from them, :mod:`.writing` makes a text of these, and
:func:`.generation.concepts` gives as many distinct ones as are asked for.
"""
