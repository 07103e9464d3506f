"""A face: a head that carries points, and the points tracked inside of it (ours).

- `target.py`: a frame's way through all of it; begin here. `state.py`: what is carried from frame to frame, and rows.
- `stabilized.py`: the frame as the head sees it.
- `landmark_sensors.py`: what places points in a frame: `cascaded_regression.py`, `eyes.py`; `mesh.py`, networks;
  `detectors.py`, which also look closer at a face.
- `landmark_filters.py`: how far each sensor is trusted, and which is right; points without windows.
- `evidence.py`: which face is the target.
- `window_ncc.py`: the likelihood of a point's window; `motion.py`: a walk that jumps.
- Loops are in the files that end in `_kernels.py`.
- `assembly.py`: from a recipe and a start to the target; the prior of shapes. `settings.py`: what a recipe may say.

Recipe: `face`.
"""
