"""What the check ``lint`` reads from a syntax tree: the code that play runs, and one module per kind of defect."""
