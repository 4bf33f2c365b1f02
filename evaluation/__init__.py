"""Labelled environments and the code that judges them. Tests assert on the verdicts; benchmarks report them."""
