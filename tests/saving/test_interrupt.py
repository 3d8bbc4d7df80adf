"""The first signal asks to stop, the second stops; the old handlers are restored."""

import signal
import subprocess
import sys
import threading

import pytest

from posegsa.errors import SearchInterrupted
from posegsa.saving.interrupt import (
    SIGNALS,
    TERMINATING,
    deferred_signals,
    immediate_signals,
    resumable,
)


@pytest.mark.parametrize("number", SIGNALS)
def test_the_first_is_noted_and_the_second_raises(number):
    before = [signal.getsignal(n) for n in SIGNALS]
    with deferred_signals() as asked:
        assert asked.signal_number is None
        signal.raise_signal(number)
        assert asked.signal_number == number
        with pytest.raises(SearchInterrupted) as stopped:
            signal.raise_signal(signal.SIGINT)
    assert isinstance(stopped.value, KeyboardInterrupt)
    assert stopped.value.signal_number == signal.SIGINT
    assert [signal.getsignal(n) for n in SIGNALS] == before


def test_a_programs_own_handler_stays():
    got = []
    previous = signal.signal(signal.SIGTERM, lambda *_: got.append("mine"))
    try:
        with deferred_signals() as asked, immediate_signals(lambda: None):
            signal.raise_signal(signal.SIGTERM)
        assert got == ["mine"]
        assert asked.signal_number is None
    finally:
        signal.signal(signal.SIGTERM, previous)


def test_other_threads_are_left_alone():
    def inside() -> None:
        with deferred_signals() as asked, immediate_signals(lambda: None):
            found.append(asked.signal_number)

    found: list[int | None] = []
    thread = threading.Thread(target=inside)
    thread.start()
    thread.join()
    assert found == [None]


@pytest.mark.parametrize("number", TERMINATING)
def test_it_raises_where_nothing_is_deferred(number):
    before, noted = signal.getsignal(number), threading.Event()
    with immediate_signals(noted.set), pytest.raises(SearchInterrupted) as stopped:
        signal.raise_signal(number)
    assert stopped.value.signal_number == number
    assert noted.is_set(), "by the thread, which the context waits for"
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", SIGNALS)
def test_what_is_stopped_says_how_to_resume(number):
    with (
        immediate_signals(lambda: None),
        pytest.raises(SearchInterrupted, match=r"^resume with: it$") as stopped,
        resumable(lambda: "resume with: something else"),
        resumable(lambda: "resume with: it"),
    ):
        signal.raise_signal(number)
    assert stopped.value.signal_number == number


def test_what_has_said_how_to_resume_prints_nothing_more():
    said = SearchInterrupted("interrupted after iteration 3", signal.SIGTERM)
    with pytest.raises(SearchInterrupted) as stopped, resumable(lambda: "something else"):
        raise said
    assert stopped.value is said


BUSY = """
import hashlib, os, signal, threading
from posegsa.saving.interrupt import immediate_signals, deferred_signals

def say():
    print("seen", flush=True)
    os.kill(os.getpid(), signal.SIGINT)  # a second time, now that the first has been seen

with immediate_signals(say), deferred_signals():
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    while True:  # in compiled code for minutes, as a chunk of a search may be
        hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
"""


ALONE = BUSY.replace("    os.kill(os.getpid(), signal.SIGINT)", "    return").replace(
    "with immediate_signals(say), deferred_signals():",
    """from posegsa.saving import interrupt
interrupt.PATIENCE = 0.1
how = interrupt.resumable(lambda: "resume with: it")
with immediate_signals(say, print), deferred_signals(), how:""",
)


@pytest.mark.parametrize("number", SIGNALS)
def test_the_first_stops_soon_in_compiled_code_and_says_how_to_resume(number):
    code = ALONE.replace(
        "os.kill, (os.getpid(), signal.SIGINT)", f"os.kill, (os.getpid(), {number})"
    )
    done = subprocess.run(
        [sys.executable, "-u", "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 128 + number, done.stderr
    assert done.stdout == "seen\nresume with: it\n"


def test_the_second_stops_at_once_in_compiled_code():
    done = subprocess.run(
        [sys.executable, "-c", BUSY], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 128 + signal.SIGINT, done.stderr
    assert done.stdout == "seen\n"
