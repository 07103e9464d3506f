"""Points of a face by factorized likelihoods: Patras & Pantic, FG 2004.

`colour_ratio.py`, where to begin: where the points start, and the likelihood of a window, eq. 8 to 10.
`shape_prior.py`: the Parzen prior over shapes, eq. 11. `point_kernels.py`: the loops. The motion (section 3.3) and the
filters (sections 2 and 4) are in `engine/`. Recipes: `factorized`, `factorized_transition`, `independent`,
`auxiliary_prior`, `sir`.
"""
