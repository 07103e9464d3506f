"""Two hands beside a head, in one posterior (ours).

- `target.py`: a hand's rows; begin here. `joint.py`: the posterior of both, and which of two is which.
- `evidence.py`: skin that moves. `hand_kernels.py`: steps and weights. `settings.py`: what a recipe may say.

Recipe: `signer`.
"""
