"""The report on a corpus: a site of static files, and the same numbers as CSV and JSON."""
