"""A box by a correlation filter, with its scale, its colours and whether it is there (ours, after several papers).

`correlation_filter.py`, where to begin: the likelihood. `features.py`: what it sees of a frame, and the filters.
`hidden_box.py`: a box that may be hidden, its walk, and particles around peaks. `box_kernels.py`: the loops. Recipe:
`correlation_filter`. A face's head is such a box.
"""
