"""A box by a correlation filter, with its scale, its colours and whether it is there (ours, after several papers).

- `settings.py`: what a recipe may say.
- `correlation_filter.py`: the likelihood; begin here.
- `features.py`: the channels of a window, its colours and its scales; `trained.py`: the filter over the channels;
  `modes.py`: how high the response stands, where its peaks are, and particles drawn around those, with exact weights.
- `hidden_box.py`: a box that may be hidden, its walk, and what others than the filter may do to it.
- `box_kernels.py`: loops.

Recipe: `correlation_filter`. A face's head is such a box.
"""
