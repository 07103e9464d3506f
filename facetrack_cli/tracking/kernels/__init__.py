"""The inner loops, compiled. Arrays in, arrays out; nothing of ours but the log is imported here, and
nothing random happens here.

Each kernel has a slow plain twin in `tests/twins/` that the tests hold it to.
"""
