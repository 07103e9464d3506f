"""A box by a correlation filter, with its scale, its colours and whether it is there (ours, after several papers).

- `settings.py`: what a recipe may say.
- `correlation_filter.py`: the likelihood; begin here.
- `features.py`: the channels of a window; `trained.py`: the filter over them; `scale.py`: its filter of size;
  `colour.py`: the colours of target and surroundings; `peak_statistics.py`: how high the response stands.
- `motion.py`, `space.py`: a walk of a box that may be hidden.
- `proposals.py`, `filters.py`: particles drawn around the modes of the response, with exact weights.
- `target.py`: what others than the filter may do to the box.

Loops are in `cell_kernels.py` and `walk_kernels.py`. Recipe: `correlation_filter`. A face's head is such a box.
"""
