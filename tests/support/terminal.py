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


def refusal(result: tuple[int, str, str], code: int) -> str:
    """The one line of a command line that was refused: exit code, stdout and stderr hold nothing else."""
    got, out, err = result
    assert (got, out) == (code, ""), err
    lines = [line for line in err.splitlines() if line.startswith("facetrack: ")]
    assert len(lines) == 1 and lines[0].startswith("facetrack: error: "), err
    assert "Traceback" not in err and "internal error" not in err
    return lines[0]
