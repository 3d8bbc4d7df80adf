"""The progress shown for long jobs: on a terminal, elsewhere, and when a job stops."""

import io
import math
import sys
import types

import pytest

from posegsa import progress, steps
from posegsa.progress import Display, span
from posegsa.steps import Step

pytestmark = pytest.mark.quick


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(autouse=True)
def usual_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")


def lines(stream: io.StringIO) -> list[str]:
    """The lines that a terminal shows at the end."""
    shown = []
    for line in stream.getvalue().split("\n"):
        cells: list[str] = []
        for part in line.split("\r"):
            cells[: len(part)] = part
        shown.append("".join(cells).rstrip())
    return shown


def test_each_step_has_its_own_line_and_time():
    stream, clock = Terminal(), Clock()
    with Display(stream=stream, clock=clock):
        steps.begin("compiling")
        assert lines(stream) == ["compiling ..."]
        clock.now = 4.0
        steps.begin("judging", 1, 5, "trust")
        assert lines(stream) == [
            "compiling: done after 4 s",
            "judging [####................] 1/5, trust",
        ]
        clock.now = 6.0
        steps.share(0.5)
        assert lines(stream)[-1] == "judging [######..............] 1/5, trust, 14 s left"
        clock.now = 20.0
    assert lines(stream) == ["compiling: done after 4 s", "judging: done after 16 s", ""]


def test_a_file_gets_a_line_now_and_then():
    stream, clock = io.StringIO(), Clock()
    with Display(stream=stream, clock=clock):
        for second in range(25):
            clock.now = float(second)
            steps.begin("judging", second, 25)
    said = stream.getvalue().splitlines()
    assert said == [
        "judging 0/25",
        "judging 10/25, 15 s left",
        "judging 20/25, 5 s left",
        "judging: done after 24 s",
    ]


@pytest.mark.parametrize("terminal", ["dumb", "xterm"])
def test_no_colour_and_on_a_dumb_terminal_no_way_back(terminal, monkeypatch):
    monkeypatch.setenv("TERM", terminal)
    monkeypatch.setenv("NO_COLOR", "1")
    stream = Terminal()
    with Display(stream=stream, clock=Clock()) as show:
        show.show(Step("searching", 1, 4, best_cost=2.0))
    assert "\x1b" not in stream.getvalue()
    assert ("\r" in stream.getvalue()) == (terminal != "dumb")


def test_nothing_is_shown_before_a_step_begins_nor_of_what_is_refused_as_it_begins():
    def refuse(*step_names: str) -> None:
        with Display(stream=stream):
            for name in step_names:
                steps.begin(name)
            raise ValueError("refused")

    stream = Terminal()
    with pytest.raises(ValueError, match="refused"):
        refuse()
    assert stream.getvalue() == ""
    with pytest.raises(ValueError, match="refused"):
        refuse("preparing")
    assert lines(stream) == [""]


def test_what_stops_is_reported():
    def stop() -> None:
        with Display(stream=stream, clock=Clock()) as show:
            show.show(Step("searching", 3, 4, best_cost=2.0))
            raise KeyboardInterrupt

    stream = Terminal()
    with pytest.raises(KeyboardInterrupt):
        stop()
    assert lines(stream) == ["searching 3/4: stopped after under 1 s, best cost 2", ""]


def test_a_note_stands_above_what_is_drawn(capsys):
    stream = Terminal()
    with Display(stream=stream):
        steps.begin("judging", 1, 2)
        progress.say("note: something")
        steps.begin("drawing", 0, 2)
        assert lines(stream)[0] == "note: something"
    progress.say("note: afterwards")
    assert capsys.readouterr().err == "note: afterwards\n"


def test_quiet_is_quiet():
    stream = Terminal()
    with Display(stream=stream, quiet=True) as show:
        steps.begin("judging", 1, 2)
    assert show.started_any
    assert stream.getvalue() == ""


def test_a_long_search_says_once_after_its_first_iteration_how_long_it_takes():
    stream, clock = io.StringIO(), Clock()
    with Display(after_search="then seconds to judge", stream=stream, clock=clock):
        steps.begin("compiling")
        clock.now = 50.0  # compile time does not count
        for done in (5, 6, 7):
            steps.tell(Step("searching", done, 105, best_cost=3.0))
            assert ("takes about 3 min" in stream.getvalue()) == (done > 5)
            clock.now += 2.0
    assert stream.getvalue().count("the search takes about 3 min; then seconds to judge\n") == 1


def test_a_short_search_is_not_announced():
    stream, clock = io.StringIO(), Clock()
    with Display(after_search="then seconds to judge", stream=stream, clock=clock):
        for done in range(3):
            steps.tell(Step("searching", done, 10, best_cost=3.0))
            clock.now += 0.1
    assert "the search takes" not in stream.getvalue()


def test_a_cost_is_shown_as_soon_as_it_exists():
    stream, clock = Terminal(), Clock()
    with Display(stream=stream, clock=clock):
        steps.tell(Step("sweeping", 2, 6, best_cost=math.inf))
        assert lines(stream) == ["sweeping [######..............] 2/6"]
        clock.now = 3.0
        steps.tell(Step("sweeping", 3.5, 6, best_cost=0.25))
        assert lines(stream) == ["sweeping [###########.........] 3/6, best cost 0.25, 5 s left"]


def test_the_cost_of_a_part_is_shown_beside_its_name_and_not_as_that_of_all():
    stream, clock = Terminal(), Clock()
    with Display(stream=stream, clock=clock):
        steps.begin("comparing", 1, 2, "gsa 2/2")
        clock.now = 4.0
        steps.share(0.5, 0.25)
        shown = "comparing [###############.....] 1/2, gsa 2/2, best cost 0.25, 4 s left"
        assert lines(stream) == [shown]
    assert lines(stream) == ["comparing: done after 4 s", ""]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.2, "under 1 s"),
        (8.2, "8 s"),
        (99, "99 s"),
        (100, "2 min"),
        (5400, "90 min"),
        (9e3, "2.5 h"),
    ],
)
def test_times_are_written_as_people_say_them(seconds, words):
    assert span(seconds) == words


def notebook(monkeypatch, name: str) -> None:
    """As if this process ran under the IPython shell of a name."""
    shell = types.SimpleNamespace(get_ipython=type(name, (), {}))
    monkeypatch.setitem(sys.modules, "IPython", shell)


@pytest.mark.parametrize("shell", ["ZMQInteractiveShell", "TerminalInteractiveShell"])
def test_a_job_without_a_listener_shows_its_steps_in_a_notebook_alone(monkeypatch, capsys, shell):
    notebook(monkeypatch, shell)
    with progress.shown(None):
        steps.begin("judging", 1, 5, "trust")
    assert ("1/5, trust" in capsys.readouterr().err) == (shell == "ZMQInteractiveShell")


def test_a_listener_in_a_notebook_takes_the_place_of_what_is_shown(monkeypatch, capsys):
    notebook(monkeypatch, "ZMQInteractiveShell")
    reports = []
    with progress.shown(reports.append), progress.shown(None):
        steps.begin("judging")
    assert [step.name for step in reports] == ["judging"]
    assert capsys.readouterr().err == ""
