"""Environments that have been validated, in the hands of an agent: alone, many side by side, by Gymnasium's ids."""
