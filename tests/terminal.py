"""What a program says to a terminal."""

import os


def read_all(ours: int) -> str:
    """All that comes out of our end of a pseudo-terminal until the other end is closed; closes ours."""
    data = b""
    while True:
        try:
            more = os.read(ours, 4096)
        except OSError:  # how Linux says that the other end is closed
            break
        if not more:
            break
        data += more
    os.close(ours)
    return data.decode()
