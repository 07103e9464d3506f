"""Hostile inputs, made from seeds: every command must answer each in one clear line, or take it.

`python -m tests.fuzz 500` tries so many cases, `python -m tests.fuzz truth-17` one, and shows what it says.
"""
