"""A face under affine maps that adapts and may be recognised: Zhou, Chellappa & Moghaddam, ICME 2003.

"Adaptive Visual Tracking and Recognition using Particle Filters".

- `settings.py`: what a recipe may say.
- `space.py`: the six affine parameters, and how a patch is read from a frame (eq. 3).
- `appearance.py`: the mixture W, S, F, eq. 6 to 11; loops in `mixture_kernels.py`.
- `velocity.py`: the predicted shift, the adaptive noise and the number of particles, eq. 12, 13 and 17; loops in
  `velocity_kernels.py`.
- `recognition.py`: motion and identity in one posterior, eq. 5; `gallery.py`, `subspaces.py`: eq. 14 to 16;
  `gallery_fit.py`: a gallery learned from faces.

Recipes: `adaptive` and those whose names begin with it, `fixed_template`.
"""
