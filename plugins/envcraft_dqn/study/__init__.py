"""``envcraft study``: experiments over many environments, from their selection to a report."""
