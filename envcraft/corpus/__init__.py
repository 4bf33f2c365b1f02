"""Corpora: the store of environments and verdicts, audits, duplicates, records, reports and exports."""
