"""Two hands beside a head, in one posterior (ours).

- `target.py`: the posterior of both, which of two is which, and their rows; begin here.
- `evidence.py`: skin that moves. `hand_kernels.py`: steps and weights. `settings.py`: what a recipe may say.

Recipe: `signer`.
"""
