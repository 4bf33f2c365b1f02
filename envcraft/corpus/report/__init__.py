"""The report on a corpus: a site of plain files, with the same numbers as CSV and JSON.

``data`` reads and counts, ``media`` plays and draws, ``charts`` and ``site`` write; ``command`` is what people type.
"""
