"""A head as a box: Odobez, Ba & Gatica-Perez, IDIAP-RR 03-15, 2003.

"An Implicit Motion Likelihood for Tracking with Particle Filters".

- `likelihoods.py`: edges and colours of the box (section 3.3, eq. 11), its correlation with itself in the frame before
  (sections 3.1 and 3.3, eq. 12 and 13), and the product of likelihoods (eq. 10).
- `settings.py`: what a recipe may say. `region_kernels.py`: the loops.

Its motion, dynamics of value and speed (section 3.2), is in `engine/spaces.py`. Recipes: `contour`, `histogram`, and
those whose names have both.
"""
