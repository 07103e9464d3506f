"""Everybody in a film (ours): what each face looks like, and who is who.

- `descriptor.py`: what a face looks like. `identity.py`: who is who.

The tracks of a shot are made in `start/presence.py`, as each of them begins with a search.
"""
