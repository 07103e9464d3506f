"""A head as a box: Odobez, Ba & Gatica-Perez, IDIAP-RR 03-15, 2003.

"An Implicit Motion Likelihood for Tracking with Particle Filters".

- `settings.py`: what a recipe may say.
- `histogram.py`, `contour.py`: colours and edges of the box (section 3.3, eq. 11).
- `correlation.py`: the correlation of the box with itself in the frame before (sections 3.1 and 3.3).
- `product.py`: their product (eq. 10).

Its motion, dynamics of value and speed (section 3.2), is in `engine/motion.py`. Loops are in the files that end in
`_kernels.py`. Recipes: `contour`, `histogram`, and those whose names have both.
"""
