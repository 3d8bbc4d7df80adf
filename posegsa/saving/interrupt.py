"""Ctrl-C and SIGTERM: the first asks a search to save its state and stop, the second stops it.

Python handles signals in the main thread only. A program's own handlers are left alone, and so is
SIGINT where it is ignored, as under `nohup`.
"""

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from posegsa.errors import SearchInterrupted

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Whether a signal has asked the search to stop."""

    signal_number: int | None = None
    """The first signal that did."""


@contextmanager
def deferred_signals() -> Iterator[StopRequest]:
    """Note the first signal, to be looked at later; the second raises SearchInterrupted."""
    request = StopRequest()

    def note(number: int, frame: FrameType | None) -> None:
        if request.signal_number is not None:
            raise SearchInterrupted("stopped", number)
        request.signal_number = number

    with _handled(note):
        yield request


@contextmanager
def immediate_signals(on_first: Callable[[], object]) -> Iterator[None]:
    """Have SIGTERM raise as Ctrl-C does, and a second signal end the process at once.

    Python handles signals between its own steps only, not while a compiled loop runs; so a thread
    reads them from the system, and calls `on_first` at the first. For programs that own their
    process, such as the command line.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)

    def watch() -> None:
        first = True
        while number := reader.recv(1):
            if number[0] in SIGNALS:
                if not first:
                    os._exit(128 + number[0])
                on_first()
                first = False

    def terminated(number: int, frame: FrameType | None) -> NoReturn:
        raise SearchInterrupted("stopped", number)

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    previous = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    _OWN.add(terminated)
    try:
        with _handled(terminated, (signal.SIGTERM,)):
            yield
    finally:
        _OWN.discard(terminated)
        signal.set_wakeup_fd(previous)
        writer.close()
        thread.join()
        reader.close()


_OWN: set[object] = set()
"""Handlers of this module, which may replace each other."""


@contextmanager
def _handled(
    handler: Callable[[int, FrameType | None], object], numbers: tuple[int, ...] = SIGNALS
) -> Iterator[None]:
    """Handle those of the signals that have no handler of the program's own."""
    usual = {signal.SIG_DFL, signal.default_int_handler, *_OWN}
    previous = {}
    if threading.current_thread() is threading.main_thread():
        for number in numbers:
            if signal.getsignal(number) in usual:
                previous[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)
