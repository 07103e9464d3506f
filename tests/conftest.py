"""What holds for every test."""

import signal

# a shell starts what it puts into the background with Ctrl-C ignored, and every process that the tests start inherits
# that: the tests of Ctrl-C would wait for a signal that never comes
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
