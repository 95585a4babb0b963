"""What all tests share."""

import signal

# A shell ignores Ctrl-C for what it starts in the background, and so would the commands that tests interrupt.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
