"""Points of a face by factorized likelihoods: Patras & Pantic, FG 2004.

"Particle Filtering with Factorized Likelihoods for Tracking Facial Features". Each point is the centre of a window.

- `colour_ratio.py`, where to begin: where the points start, and the likelihood of a window, eq. 8 to 10.
- `shape_prior.py`: the Parzen prior over shapes, eq. 11, how it is fitted and stored.
- `settings.py`: what a recipe may say. `point_kernels.py`: the loops.

The motion, a random walk (section 3.3), and the filters (sections 2 and 4) are in `engine/`, as other trackers use
them too. Recipes: `factorized`, `factorized_transition`, `independent`, `auxiliary_prior`, `sir`.
"""
