"""A face under affine maps that adapts and may be recognised: Zhou, Chellappa & Moghaddam, ICME 2003.

"Adaptive Visual Tracking and Recognition using Particle Filters".

- `appearance.py`, where to begin: the six affine parameters, how a patch is read from a frame (eq. 3), the predicted
  shift and the adaptive noise (eq. 12 and 13); the mixture W, S, F, eq. 6 to 11; motion and identity in one posterior,
  eq. 5. The filter with its number of particles (eq. 17) is beside the others in `engine/filters.py`.
- `gallery.py`: eq. 14 to 16, and a gallery learned from faces.
- `settings.py`: what a recipe may say. `appearance_kernels.py`: the loops.

Recipes: `adaptive` and those whose names begin with it, `fixed_template`.
"""
