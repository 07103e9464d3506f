"""The processes that run the tests, and those that tests start, share the cores: threads of their own only wait.

Here, since libraries read it when they are imported, as the modules of tests and conftest.py do.
"""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(variable, "1")
