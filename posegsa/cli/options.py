"""Arguments that several commands share, and how they are read.

Here and in the commands' modules, slow imports are inside functions, so that help and errors about
arguments appear at once.
"""

import argparse
import importlib
import sys
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from posegsa.config import shipped
from posegsa.errors import ArgumentError, PosegsaWarning
from posegsa.recordings.frames import UP
from posegsa.recordings.policies import LONGEST_GAP, Policy
from posegsa.recordings.readers import IN_WORDS

if TYPE_CHECKING:
    from posegsa.judging.result import Result
    from posegsa.recordings.frames import Frame
    from posegsa.recordings.recording import Recording
    from posegsa.search.configured_filters import OwnFilter

RECORDING = f"a recording: {IN_WORDS}"


def add_search_arguments(
    parser: argparse.ArgumentParser, *, config: str, setting: str, out: str, replaced: str
) -> None:
    """CONFIG, --set, --out, --overwrite and --quiet, for a command that searches.

    Args:
        parser: The command's parser.
        config: The default configuration, in words.
        setting: An example for --set.
        out: Help text of --out.
        replaced: What --overwrite replaces, in words.
    """
    words = f"TOML file of the experiment, or a name from `posegsa configs` (default: {config})"
    parser.add_argument("config", nargs="?", metavar="CONFIG", help=words)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help=f"change a value of the experiment, e.g. {setting}; may be given several times",
    )
    parser.add_argument("--out", metavar="DIR", help=out)
    parser.add_argument("--overwrite", action="store_true", help=f"replace {replaced}")
    add_quiet(parser)


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """--quiet, for a command that shows progress."""
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def add_figures(parser: argparse.ArgumentParser) -> None:
    """--figures and --no-figures, for a command that draws. `options.figures` is None for all."""
    group = parser.add_mutually_exclusive_group()
    words = "draw only these figures (names separated by commas)"
    group.add_argument("--figures", type=_names, metavar="NAMES", help=words)
    words = "draw no figures"
    group.add_argument("--no-figures", action="store_const", const=[], dest="figures", help=words)


def add_filter(parser: argparse._ActionsContainer) -> None:
    """--filter, for a command that runs a filter of the user's own."""
    words = (
        "your own filter, if filter.kind is own: its class in a module that Python finds from "
        "here (docs/own_filter.md)"
    )
    parser.add_argument("--filter", metavar="MODULE:CLASS", help=words)


def own_filter(options: argparse.Namespace) -> "OwnFilter | None":
    """The object that --filter names, imported; None without it.

    Raises:
        ArgumentError: There is no such module, or nothing of that name in it.
    """
    if (given := options.filter) is None:
        return None
    module, _, name = given.partition(":")
    if not (module and name):
        raise ArgumentError(f"--filter {given}; allowed: MODULE:CLASS, such as my_filter:MyFilter")
    if "" not in sys.path:
        sys.path.insert(0, "")  # the current folder, as for `python -m`
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ArgumentError(f"--filter {given}: {error}") from None


def add_run(parser: argparse.ArgumentParser, *also: str) -> None:
    """RUN, --filter, --edited and --set, for a command that reads a tuned filter.

    Args:
        parser: The command's parser.
        also: Other things that RUN may be, in words.
    """
    words = (
        "folder of a finished run; or the name of a configuration (`posegsa configs`) or a TOML "
        "file, for the filter with the numbers in it"
    )
    parser.add_argument("run", metavar="RUN", help="; ".join([words, *also]))
    add_filter(parser)
    words = "read a result.json that was changed after posegsa wrote it"
    parser.add_argument("--edited", action="store_true", help=words)
    words = (
        "change a value of the configuration, e.g. filter.magnetometer_delay=0 of imu; may be "
        "given several times"
    )
    parser.add_argument("--set", action="append", metavar="SECTION.KEY=VALUE", help=words)


def result_of(options: argparse.Namespace, recording: "Recording | None" = None) -> "Result":
    """The tuned filter that RUN names: from a run's folder, or as configured.

    Args:
        options: Parsed options with RUN.
        recording: The filter knows the vectors and landmarks of this recording; None for its own.

    Raises:
        ArgumentError: --edited is given for a configuration, or --set for the folder of a run.
        ConfigError: The configuration can't be read, or a value of --set is not allowed.
    """
    from posegsa.config.toml_files import load as load_config
    from posegsa.config.toml_files import override
    from posegsa.configuring import configured
    from posegsa.saving.result_files import load

    if is_configuration(options.run):
        if options.edited:
            raise ArgumentError(f"--edited; allowed: with the folder of a run, not {options.run}")
        own = [] if recording is None else [recording]
        chosen = override(load_config(options.run), options.set or [])
        return configured(chosen, filter=own_filter(options), recordings=own)
    if options.set:
        raise ArgumentError(f"--set; allowed: with a configuration, not {options.run}")
    result = load(options.run, filter=own_filter(options), edited=options.edited)
    return result if recording is None else result.with_sensors_of(recording)


def is_configuration(run: str) -> bool:
    """Whether RUN is a configuration and not a folder."""
    return not Path(run).is_dir() and (run.endswith(".toml") or run in shipped.names())


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def add_count(parser: argparse.ArgumentParser, name: str, default: int, words: str) -> None:
    """An option for a whole number from 1; `words` say what it counts."""
    words = f"{words} (default: %(default)s)"
    parser.add_argument(name, type=whole_number(1), default=default, metavar="N", help=words)


def whole_number(minimum: int) -> Callable[[str], int]:
    """A function that reads a whole number from a minimum on."""

    def read(text: str) -> int:
        number = int(text) if text.isdecimal() else -1
        if number < minimum:
            raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number from {minimum}")
        return number

    return read


def add_window(parser: argparse._ActionsContainer) -> None:
    """--window, the part of each recording that is used."""
    words = "use only these seconds of each recording, e.g. 0:40, 40: or :40"
    parser.add_argument("--window", metavar="A:B", type=window, help=words)


def window(text: str) -> tuple[float, float]:
    """Read a window in seconds."""
    begin, colon, end = text.partition(":")
    try:
        found = float(begin or 0.0), float(end or "inf")
    except ValueError:
        found = (1.0, 0.0)
    if not colon or not 0 <= found[0] < found[1]:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: A:B in seconds, such as 0:40 or 40:")
    return found


def add_frame(parser: argparse._ActionsContainer, default: str = "its own, or ENU") -> None:
    """--frame, for recordings of inertial sensors; `default` says which frame it is without."""
    words = (
        "of recordings of an inertial sensor (imu): x, y and z of the inertial frame (default: "
        f"{default})"
    )
    parser.add_argument("--frame", type=str.upper, choices=tuple(UP), help=words)


def as_read_with(
    options: argparse.Namespace, kind: str, recordings: "list[Recording]"
) -> "list[Recording]":
    """Recordings as a kind of filter reads them.

    Raises:
        ArgumentError: --frame is given for a filter that reads no inertial sensors.
    """
    from posegsa.recordings.imu import as_read_by

    if options.frame is not None and kind != "imu":
        raise ArgumentError("--frame; allowed: with the filter for inertial sensors (imu)")
    return [as_read_by(kind, each) for each in recordings]


def add_bridge(parser: argparse._ActionsContainer) -> None:
    """--bridge and --longest-gap, how gaps of a recording are bridged."""
    parser.add_argument(
        "--bridge",
        choices=get_args(Policy),
        help="what to do about gaps, time stamps that go back and samples without velocities: "
        "refuse the recording (default), keep gaps as they are (default of an inertial sensor), "
        "fill them and hold the last velocities, or interpolate them",
    )
    words = f"longest gap that is bridged [s] (default: {LONGEST_GAP:g}; with keep, any)"
    parser.add_argument("--longest-gap", type=float, metavar="S", help=words)


def read(
    paths: list[str],
    part: tuple[float, float] | None,
    bridge: Policy | None = None,
    longest_gap: float | None = None,
    frame: "Frame | None" = None,
    usual: "Frame | None" = None,
    **more: Any,
) -> "list[Recording]":
    """Read recordings, bridge their gaps if asked to, and cut them to a window.

    They are in the inertial frame of the option --frame, else in that which they state, else in the
    `usual` one. `more` are further arguments of `Recording.read`.

    Raises:
        ArgumentError: A longest gap is given, but gaps are not bridged.
    """
    from posegsa.recordings.recording import Recording

    if longest_gap is not None and bridge in (None, "refuse"):
        raise ArgumentError("--longest-gap; allowed: with --bridge keep, hold or interpolate")
    stated = {"bridge": bridge, "longest_gap": longest_gap}
    more |= {name: value for name, value in stated.items() if value is not None}
    found = [_in_frame(Recording.read(path, **more), path, frame, usual) for path in paths]
    return found if part is None else [each.window(*part) for each in found]


def _in_frame(
    one: "Recording", path: str, frame: "Frame | None", usual: "Frame | None"
) -> "Recording":
    """A recording in the frame of --frame, else its own, else the usual one, if there is one."""
    from dataclasses import replace

    from posegsa.recordings.checked_files import naming
    from posegsa.recordings.frames import check_stated

    used = frame or one.frame or usual
    if used in (None, one.frame):
        return one
    with naming(Path(path)):
        check_stated(used, one.sensors)
    if one.frame is not None:
        words = f"{one.name}: --frame {used} instead of the frame that it states, {one.frame}"
        warnings.warn(words, PosegsaWarning, stacklevel=3)
    return replace(one, frame=used)


def warn_of_mistakes(recordings: "Iterable[Recording]") -> None:
    """Warn of the mistakes that recordings seem to have, before a filter runs on them."""
    from posegsa.recordings.data_check import check

    for one in recordings:
        for words in check(one).findings:
            warnings.warn(f"{one.name}: {words}", PosegsaWarning, stacklevel=2)
