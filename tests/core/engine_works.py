"""Works for the engine's tests: functions of a module, so that spawned processes find them."""

import os
import signal


def squares(items):
    return [i * i for i in items]


def deadly(items):
    """Item 13 ends the process that takes it."""
    if 13 in items:
        os.kill(os.getpid(), signal.SIGKILL)
    return list(items)


def wrong(items):
    raise ZeroDivisionError("a work's own error")
