"""How inner loops are compiled, and those that several trackers share. Arrays in, arrays out; nothing random.

The kernels of a tracker are beside it, in files that end in `_kernels.py`. They import nothing of ours but this folder.
Each kernel has a slow plain twin in `tests/twins/` that the tests hold it to.
"""
