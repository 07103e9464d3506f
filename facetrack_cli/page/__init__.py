"""The page on which targets are chosen and corrected: a server on the loopback address, and what it serves."""
