"""What the server that forks workers loads first: it ends with its parent, also while it still loads the rest."""

import os
import signal

_parent = os.getppid()


def _look(*_: object) -> None:
    if os.getppid() != _parent:
        os._exit(1)


signal.signal(signal.SIGALRM, _look)  # not a thread, beside which it could not fork
signal.setitimer(signal.ITIMER_REAL, 1.0, 1.0)  # which forks do not inherit
