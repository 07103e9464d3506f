"""Everybody in a film (ours): `descriptor.py` says what each face looks like, and who is who.

The tracks of a shot are made in `start/presence.py`, as each of them begins with a search.
"""
