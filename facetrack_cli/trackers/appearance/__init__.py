"""A face under affine maps that adapts and may be recognised: Zhou, Chellappa & Moghaddam, ICME 2003.

`appearance.py`, where to begin: state, patches, motion, appearance and the joint posterior. `gallery.py`: who is known,
eq. 14 to 16. `appearance_kernels.py`: the loops. The filter (eq. 17) is in `engine/filters.py`. Recipes: `adaptive` and
those whose names begin with it, `fixed_template`.
"""
