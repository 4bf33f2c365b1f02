"""What the check ``determinism`` compares: the conditions, the traces, the cause of a difference, and other seeds."""
