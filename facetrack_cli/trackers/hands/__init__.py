"""Two hands beside a head, in one posterior (ours).

`target.py`, where to begin: the posterior of both, which of two is which, and their rows. `evidence.py`: skin that
moves. `hand_kernels.py`: steps and weights. Recipe: `signer`.
"""
