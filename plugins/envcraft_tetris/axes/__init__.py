"""The axes along which variants differ, one a module: each draws its values, and writes the code that they need."""
