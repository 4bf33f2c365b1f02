"""The explorer: ``envcraft explore`` serves the pages of a corpus and plays its environments in the sandbox."""
