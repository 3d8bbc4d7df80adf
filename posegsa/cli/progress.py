"""What the command line shows of long work, on standard error.

On a terminal the last line is that of the present step: how much of it is done and how long the
rest will take. Elsewhere, as in a file or on a terminal that can't go back in a line (TERM=dumb), a
line is written now and then. Neither has colours (NO_COLOR).
"""

import io
import math
import os
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Self, TextIO

from posegsa import steps
from posegsa.steps import Step

BETWEEN_LINES = 10.0
"""Time between two lines of the same part, where nothing is drawn [s]."""
BETWEEN_DRAWN = 0.1
"""Time between two states of a line that is drawn [s]."""
BAR = 20
"""Characters of the bar."""
LONG = 10.0
"""Time from which on that of a whole search is said after its first iteration [s]."""


class Display:
    """A context that shows the steps of the work within it.

    Nothing is shown before the first step begins: of work that is refused nothing is seen.
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        after_search: str = "",
        stream: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Show steps.

        Args:
            quiet: Show nothing.
            after_search: What comes after the search, in words. Where it is given, a line says
                after the first iteration how long the search will take.
            stream: Where to; by default standard error.
            clock: The time [s].
        """
        given = sys.stderr if stream is None else stream
        self.stream = io.StringIO() if given is None else given  # standard error may be closed
        self.quiet, self.after_search, self.clock = quiet, after_search, clock
        self.drawn = self.stream.isatty() and os.environ.get("TERM") != "dumb"
        self.present: Step | None = None
        """The step that is shown."""
        self.began = False
        """Whether any step has begun."""
        self._begun = self._written = 0.0
        self._began_with = 0.0
        self._width = 0
        self._context = ExitStack()

    def __enter__(self) -> Self:
        """Listen to the steps."""
        self._context.enter_context(steps.listening(self.show))
        _SHOWN.append(self)
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        """End the present step."""
        self._context.close()
        _SHOWN.remove(self)
        self._end("stopped" if error is not None else "done")

    def show(self, step: Step) -> None:
        """Show where the work stands."""
        now, before = self.clock(), self.present
        if before is None or step.name != before.name:
            self._end("done")
            self._begun, self._began_with = now, step.done
            before = None
        self.present, self.began = step, True
        self._say_whole(now)
        another = before is None or step.about != before.about
        whole = step.done >= step.parts
        least = BETWEEN_DRAWN if self.drawn else BETWEEN_LINES
        if another or now - self._written >= least or (self.drawn and whole):
            self._write(self._words(now))
            self._written = now

    def say(self, text: str) -> None:
        """Write a line above what is drawn."""
        self._clear()
        print(text, file=self.stream, flush=True)

    def _say_whole(self, now: float) -> None:
        """Say once, after the first iteration of a search, how long all of it takes."""
        assert self.present is not None
        done = self.present.done - self._began_with
        if not self.after_search or self.present.best_cost is None or done < 1:
            return
        whole = (now - self._begun) / done * (self.present.parts - self._began_with)
        if whole >= LONG and not self.quiet:
            self.say(f"about {span(whole)} to search; {self.after_search}")
        self.after_search = ""

    def _end(self, ended: str) -> None:
        """Leave a line of the step that was shown, with the time that it took."""
        if self.present is None or self.quiet:
            return
        name, done, parts, _, best_cost = self.present
        self.present = None
        if ended == "stopped" and done == 0:  # of what was refused as it began nothing stays
            self._clear()
            return
        took = f"{ended} after {span(self.clock() - self._begun)}"
        count = f" {int(done)}/{parts}" if best_cost is not None else ""
        known = best_cost is not None and math.isfinite(best_cost)
        best = f", best cost {best_cost:.4g}" if known else ""
        self.say(f"{name}{count}: {took}{best}")

    def _words(self, now: float) -> str:
        """The present step in words."""
        assert self.present is not None
        name, done, parts, about, best_cost = self.present
        if parts == 1 and done == 0:
            return f"{name}{f' {about}' if about else ''} ..."
        if best_cost is not None and math.isfinite(best_cost):
            about = f"best cost {best_cost:.4g}"
        left = self._left(now)
        tail = [about] * bool(about) + [f"{span(left)} left"] * (left is not None)
        bar = ""
        if self.drawn:
            filled = int(BAR * min(done / parts, 1))
            bar = f"[{'#' * filled}{'.' * (BAR - filled)}] "
        return f"{name} {bar}{', '.join([f'{int(done)}/{parts}', *tail])}"

    def _left(self, now: float) -> float | None:
        """The time that the rest of the step will take [s], once that can be told."""
        assert self.present is not None
        done, elapsed = self.present.done - self._began_with, now - self._begun
        if done <= 0 or elapsed < 1:
            return None
        return elapsed / done * (self.present.parts - self.present.done)

    def _write(self, text: str) -> None:
        if self.quiet:
            return
        if not self.drawn:
            self.say(text)
            return
        columns = shutil.get_terminal_size().columns - 1
        line = text[:columns]
        self.stream.write("\r" + line.ljust(self._width))
        self.stream.flush()
        self._width = len(line)

    def _clear(self) -> None:
        if self._width:
            self.stream.write("\r" + " " * self._width + "\r")
            self._width = 0


_SHOWN: list[Display] = []


def say(text: str) -> None:
    """Write a line to standard error, above what is drawn there."""
    if _SHOWN:
        _SHOWN[-1].say(text)
    else:
        print(text, file=sys.stderr or io.StringIO(), flush=True)


def span(seconds: float | None) -> str:
    """A time for a person: "8 s", "4 min", "2.5 h"."""
    if seconds is None or seconds < 0.95:
        return "under 1 s"
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 99.5 * 60 else f"{seconds / 3600:.1f} h"
