"""``envcraft study generalisation``: does an agent play better than chance in environments that it has never seen?"""
