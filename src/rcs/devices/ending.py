"""What open devices do when a program in Python ends: they hold. Signals are minded in `core/src/termination.cpp`."""

from __future__ import annotations

import atexit
import functools
import sys
import threading

from rcs._core import stop_all


@functools.cache
def hold_at_the_end() -> None:
    """Have every open device that moves hold at exit, and after an exception that nobody handles, in any thread.

    The first device that opens calls it. At a prompt, which goes on after an exception, so do the devices.
    """
    atexit.register(stop_all, "the program ended without closing its devices")
    told, told_in_thread = sys.excepthook, threading.excepthook

    def on_exception(kind: type[BaseException], error: BaseException, *trace: object) -> None:
        if not hasattr(sys, "ps1"):
            stop_all(f"the program ended with {kind.__name__}: {error}")
        told(kind, error, *trace)  # pyright: ignore[reportArgumentType]

    def on_exception_in_thread(args: threading.ExceptHookArgs) -> None:
        if not issubclass(args.exc_type, SystemExit) and not hasattr(sys, "ps1"):
            thread = args.thread.name if args.thread is not None else "that has ended"
            stop_all(f"the thread {thread!r} ended with {args.exc_type.__name__}: {args.exc_value}")
        told_in_thread(args)

    sys.excepthook, threading.excepthook = on_exception, on_exception_in_thread
