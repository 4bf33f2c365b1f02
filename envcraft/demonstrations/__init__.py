"""Demonstrations: recorded play of the environments of a corpus, and the transitions to learn from.

A recording (:mod:`~envcraft.demonstrations.format`) has seeds, actions and a digest of every frame: it is small, and
playing the actions again gives exactly the same frames. A cache (:mod:`~envcraft.demonstrations.cache`) has the frames
and can always be made again. :class:`~envcraft.demonstrations.dataset.Demonstrations` reads caches.
"""
