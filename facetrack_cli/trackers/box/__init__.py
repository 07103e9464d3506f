"""A box by a correlation filter, with its scale, its colours and whether it is there (ours, after several papers).

- `settings.py`: what a recipe may say.
- `correlation_filter.py`: the likelihood, and how high its response stands; begin here.
- `features.py`: the channels of a window, its colours and its scales; the filter over the channels, and its peaks.
- `hidden_box.py`: a box that may be hidden, its walk, and particles drawn around peaks, with exact weights.
- `box_kernels.py`: loops.

Recipe: `correlation_filter`. A face's head is such a box.
"""
