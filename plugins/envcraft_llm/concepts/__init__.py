"""Concepts: ideas for games, combined from curated pools without a model.

:mod:`.pools` loads the pools, :mod:`.strategies` draws ingredients from them, :mod:`.writing` turns these into a text,
and :func:`.generation.concepts` generates distinct concepts.
"""
