"""Demonstrations: what players did in the environments of a corpus, and the trajectories to learn from.

The canonical form (:mod:`~envcraft.demonstrations.form`) is seeds and actions, with a digest of every frame: small, and
exact by playing it again. Frames are kept in a cache beside (:mod:`~envcraft.demonstrations.cache`), which can be made
anew at any time, and which :class:`~envcraft.demonstrations.reading.Demonstrations` reads.
"""
