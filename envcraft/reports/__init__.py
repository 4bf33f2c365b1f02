"""Reporters, one format a file, and what several of them share."""
