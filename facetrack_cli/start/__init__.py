"""Where a track begins: init files, the search for a face, and what makes a tracker of it (`assembly.py`)."""
