"""Checks on subjects: the engine, the rollouts that checks request, and the workers that run them."""
