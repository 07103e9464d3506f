"""All figures, as matplotlib Figures from arrays; `style.render` makes the bytes of a file."""
