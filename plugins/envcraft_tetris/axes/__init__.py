"""The axes along which variants differ, one per module: each draws its values and writes the code for them."""
