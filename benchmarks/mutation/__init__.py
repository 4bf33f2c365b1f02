"""Planted defects: mutation operators, the good games that they change, and what checkers find."""
