"""A face: a head that carries points, and the points tracked inside of it (ours).

- `target.py`: a frame's way through all of it; begin here. `state.py`: what is carried from frame to frame.
- `stabilized.py`: the frame as the head sees it.
- `senses.py`: what places points: `descent.py` and `eyes.py`, regressions; `mesh.py`, networks; `detectors.py`.
- `sensors.py`: how far each is trusted, and which is right. `evidence.py`: which face is the target.
- `window_ncc.py`: the likelihood of a point's window; `motion.py`: a walk that jumps; `shape_prior.py`: shapes.
- `mesh_points.py`: points without windows. `closer.py`, `points.py`: a face looked at again, and its five points.
- Loops are in the files that end in `_kernels.py`.
- `assembly.py`: from a recipe and a start to the target. `settings.py`: what a recipe may say.

Recipe: `face`.
"""
