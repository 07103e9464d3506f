"""What all trackers share: the loop over frames, a target, the filters side by side, resampling, confidence.

Nothing here knows a tracker. A tracker gives a state space, a motion and a likelihood, as `protocols.py` says; some
give filters or a target of their own. Begin with `loop.py`, a screen, then `target.py` and `filters.py`.
"""
