"""Hold open devices when a Python program ends. `core/src/termination.cpp` handles signals."""

from __future__ import annotations

import atexit
import functools
import sys
import threading

from rcs._core import stop_all


@functools.cache
def hold_at_the_end() -> None:
    """Hold every open device that moves, at exit and after an unhandled exception in any thread.

    The first device that opens calls it. At an interactive prompt, which continues after an exception, devices
    continue, too.
    """
    atexit.register(stop_all, "the program ended without closing its devices")
    hook, thread_hook = sys.excepthook, threading.excepthook

    def on_exception(kind: type[BaseException], error: BaseException, *trace: object) -> None:
        if not hasattr(sys, "ps1"):
            stop_all(f"the program ended with {kind.__name__}: {error}")
        hook(kind, error, *trace)  # pyright: ignore[reportArgumentType]

    def on_exception_in_thread(args: threading.ExceptHookArgs) -> None:
        if not issubclass(args.exc_type, SystemExit) and not hasattr(sys, "ps1"):
            thread = getattr(args.thread, "name", "that has ended")
            stop_all(f"the thread {thread!r} ended with {args.exc_type.__name__}: {args.exc_value}")
        thread_hook(args)

    sys.excepthook, threading.excepthook = on_exception, on_exception_in_thread
