"""What the check ``api`` reads from the code: the lines of spaces, results and writes."""
