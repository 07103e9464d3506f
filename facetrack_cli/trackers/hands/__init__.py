"""Two hands beside a head, in one posterior (ours).

- `target.py`: a hand's rows; begin here. `joint.py`: the posterior of both. `evidence.py`: skin that moves.
- `names.py`: which of two is which. `settings.py`: what a recipe may say.

Recipe: `signer`.
"""
