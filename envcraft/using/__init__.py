"""Only the entry point that data sets of earlier versions name."""
