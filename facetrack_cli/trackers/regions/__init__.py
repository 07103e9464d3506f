"""A head as a box: Odobez, Ba & Gatica-Perez, IDIAP-RR 03-15, 2003.

`likelihoods.py`: edges, colours and correlation of the box (sections 3.1 and 3.3), and their product.
`region_kernels.py`: the loops. The motion (section 3.2) is in `engine/spaces.py`. Recipes: `contour`, `histogram`, and
those whose names have both.
"""
