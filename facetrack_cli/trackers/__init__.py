"""The trackers, a folder each: settings, likelihoods, motion, state spaces and kernels, with the paper on top.

`settings.py` of a folder declares what a recipe may say, belongs to the room `recipe`, and imports no numerics; all
else computes with it. `__init__.py` says what each file holds.
"""
