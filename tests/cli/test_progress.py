"""What is shown of long work: on a terminal, elsewhere, and when it stops."""

import io
import math

import pytest

from posegsa import steps
from posegsa.cli import progress
from posegsa.cli.progress import CompareDisplay, Display, SweepDisplay, TuneDisplay, span
from posegsa.comparing import Status
from posegsa.search.run import Progress
from posegsa.steps import Step
from posegsa.sweeping import SweepStatus

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
    """What a terminal shows in the end."""
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
    def refuse(*begun: str) -> None:
        with Display(stream=stream):
            for name in begun:
                steps.begin(name)
            raise ValueError("refused")

    stream = Terminal()
    with pytest.raises(ValueError, match="refused"):
        refuse()
    assert stream.getvalue() == ""
    with pytest.raises(ValueError, match="refused"):
        refuse("preparing")
    assert lines(stream) == [""]


def test_what_stops_says_so():
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
    assert show.began
    assert stream.getvalue() == ""


def test_a_long_search_says_after_its_first_iteration_how_long_it_takes(capsys):
    with TuneDisplay("then seconds to judge what it finds") as show:
        show(Progress(5, 105, 3.0, 0.0))
        assert "about" not in capsys.readouterr().err
        show(Progress(6, 105, 3.0, 2.0))
        show(Progress(7, 105, 3.0, 4.0))
    said = capsys.readouterr().err
    assert said.count("about 3 min to search; then seconds to judge what it finds") == 1
    with TuneDisplay("") as show:
        show(Progress(0, 10, 3.0, 0.0))
        show(Progress(1, 10, 3.0, 0.1))
    assert "to search" not in capsys.readouterr().err


def test_the_pieces_of_a_first_iteration_say_how_long_it_takes(capsys):
    with TuneDisplay("") as show:
        show(Progress(0, 10, math.inf, 0.0))
        show(Progress(0, 10, math.inf, 3.0, share=0.25))
        assert "about" not in capsys.readouterr().err, "too early to tell"
        show(Progress(0, 10, math.inf, 6.0, share=0.5))
        assert "about 2 min to search" in capsys.readouterr().err
        show(Progress(0, 10, math.inf, 11.5, share=0.96))
    assert capsys.readouterr().err == "searching 0/10: done after under 1 s\n"


def test_what_a_folder_held_of_a_comparison_counts_as_done(capsys):
    with CompareDisplay(["gsa", "de"]) as show:
        show(Status("de", 1, 2, 0.5, 3.0))
        assert show.present is not None
        assert (show.present.done, show.present.parts) == (3.5, 4)
    assert "de 2/2" in capsys.readouterr().err


def test_what_a_folder_held_of_a_sweep_counts_as_done(capsys):
    with SweepDisplay() as show:
        show(SweepStatus(done=2, runs=6, running=0.0, best_cost=math.inf))
        show(SweepStatus(done=2, runs=6, running=1.5, best_cost=0.25))
        assert show.present == Step("sweeping", 3.5, 6, best_cost=0.25)
        show(SweepStatus(done=6, runs=6, running=0.0, best_cost=math.inf))
    said = capsys.readouterr().err.splitlines()
    assert said == ["sweeping 2/6", "sweeping: done after under 1 s"]


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
def test_times_are_said_as_people_say_them(seconds, words):
    assert span(seconds) == words


def test_without_a_listener_steps_cost_nothing_and_with_one_it_is_told():
    steps.begin("unheard")
    told: list[Step] = []
    with steps.listening(told.append):
        assert list(steps.each("judging", ["a", "b"], str.upper)) == ["a", "b"]
        steps.share(0.25)
    steps.begin("unheard")
    assert told == [
        Step("judging", 0, 2, "A"),
        Step("judging", 1, 2, "B"),
        Step("judging", 1.25, 2, "B"),
    ]
