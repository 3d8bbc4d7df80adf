"""Ctrl-C and SIGTERM: the first asks a search to stop where it can go on later, the second stops.

Only the main thread gets signals, and only what nobody else handles is handled here: a program's
own handlers stay, and so does SIGINT where it is ignored, as behind `nohup`.
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


class Asked:
    """Whether a signal has asked to stop."""

    signal_number: int | None = None
    """The first one that did."""


@contextmanager
def deferred() -> Iterator[Asked]:
    """While it lasts the first signal is only noted, and the second raises KeyboardInterrupt."""
    asked = Asked()

    def note(number: int, frame: FrameType | None) -> None:
        if asked.signal_number is not None:
            raise SearchInterrupted("stopped", number)
        asked.signal_number = number

    with _handled(note):
        yield asked


@contextmanager
def at_once(say: Callable[[], object]) -> Iterator[None]:
    """While it lasts SIGTERM raises as Ctrl-C does, and a second signal ends the process.

    Python looks at signals between its own steps only, not while a compiled loop runs. A thread
    that reads them from the system does not have to wait; it is for programs that own their
    process, such as the command line.

    Args:
        say: Called by that thread at the first signal.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)

    def watch() -> None:
        told = False
        while number := reader.recv(1):
            if number[0] in SIGNALS:
                if told:
                    os._exit(128 + number[0])
                say()
                told = True

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
"""Handlers of this module, which it may replace by another of its own."""


@contextmanager
def _handled(
    handler: Callable[[int, FrameType | None], object], numbers: tuple[int, ...] = SIGNALS
) -> Iterator[None]:
    """Handle the signals that nobody else does."""
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
