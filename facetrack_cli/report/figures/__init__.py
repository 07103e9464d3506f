"""All figures, as matplotlib Figures from arrays; `style.render` makes the bytes of a file of one.

matplotlib comes with the extra `plot`; it is imported when the first figure is made, a UsageError if it is missing.
"""
