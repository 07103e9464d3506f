"""Everybody in a film (ours): the tracks of a shot, what each face looks like, and who is who.

- `presence.py`: the tracks of a shot; begin here. `looks.py`: what a face looks like. `identity.py`: who is who.
"""
