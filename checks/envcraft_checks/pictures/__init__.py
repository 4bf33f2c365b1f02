"""What the check ``observation`` reads from traces: how much pictures show, and one module per kind of defect."""
