"""The command line. Each command is a file of this folder with two functions.

`add` adds the command's parser, and `run` runs the command.
"""

import argparse
import contextlib
import errno
import gc
import logging
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from posegsa.cli import check, compare, configs, evaluate, export, replay, sweep, tune
from posegsa.cli.parser import Parser
from posegsa.config import shipped
from posegsa.errors import (
    ArgumentError,
    PosegsaError,
    PosegsaWarning,
    RecordingError,
    RunFolderError,
    SaveError,
    SearchInterrupted,
)
from posegsa.progress import say
from posegsa.recordings.readers import READERS
from posegsa.saving import interrupt
from posegsa.version import VERSION
from posegsa.words import meant


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, and return the exit status.

    0 done, 1 done but the output could not be written, 2 refused, 128 + n stopped by signal n (130
    Ctrl-C, 143 SIGTERM, 138 SIGUSR1).
    """
    if sys.stdout is None:  # closed before Python started
        print("posegsa: standard output is closed", file=sys.stderr)
        return 1
    # Traced programs are millions of long-lived objects: garbage collection as often as Python does
    # it by default takes a tenth of the time of a short command.
    gc.set_threshold(100_000, 50, 100)
    try:
        try:
            return _main(arguments)
        finally:
            sys.stdout.flush()  # now, while an error can still be reported
    except OSError as error:
        if error.filename is not None:  # a file, not standard output
            raise
        _abandon_stdout()
        print(f"posegsa: standard output: {error.strerror or error}", file=sys.stderr)
        return 1


def entry() -> NoReturn:
    """Run the command line, and end the process with its status.

    A process that was stopped by a signal ends at once, even if a thread is still compiling.
    """
    status = main()
    if status > 128:
        os._exit(status)  # the output is flushed
    sys.exit(status)


def _abandon_stdout() -> None:
    """Discard the rest of the output; Python would try to write it again when it exits."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _main(arguments: Sequence[str] | None) -> int:
    """Parse the arguments and run the command; print each known error as a line on stderr."""
    options = parser().parse_args(arguments)
    with warnings.catch_warnings():
        # Show posegsa's warnings as one line, without Python's file and line number.
        warnings.showwarning = _show_warning
        try:
            with interrupt.immediate_signals(_say_stopping, _say_stopped):
                return _run(options)
        except SaveError as error:
            # Print the whole result, with all digits, because it could not be written.
            print(f"{error.result.summary()}\n\n{error.result.filter}")
            print(f"posegsa: {error}", file=sys.stderr)
            return 1
        except PosegsaError as error:
            print(f"posegsa: {error}", file=sys.stderr)
            return 2
        except OSError as error:
            if error.filename is None or error.errno not in _UNUSABLE:
                raise
            print(f"posegsa: {error.filename}: {error.strerror}", file=sys.stderr)
            return 2
        except SearchInterrupted as stopped:
            print(f"posegsa: {stopped}", file=sys.stderr)
            return 128 + stopped.signal_number
        except KeyboardInterrupt:
            print("posegsa: interrupted", file=sys.stderr)
            return 128 + signal.SIGINT


_UNUSABLE = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.EACCES)
"""The system's errors about a path from the user that can't be used."""


def _run(options: argparse.Namespace) -> int:
    """Run the chosen command."""
    _check_names(options)
    _check_recordings(options)
    if options.command is not configs.run:
        from posegsa import runtime  # imports JAX, which `posegsa configs` does not need

        runtime.enable_fast_path()
        # Hide matplotlib's two warnings about a read-only home folder; our warning is one line.
        logging.getLogger("matplotlib").setLevel(logging.ERROR)
    return options.command(options)


def _check_names(options: argparse.Namespace) -> None:
    """Refuse a CONFIG or RUN that does not exist or is a recording, before the slow imports."""
    given = vars(options)
    config, run = given.get("config"), given.get("run")
    named = run if config is None else config
    if named is None:
        return
    if named.lower().endswith(tuple(READERS)):
        allowed = "a configuration, or none" if run is None else "a run's folder or a configuration"
        if "recording" in given:
            allowed += f"; and --recording {named}"
        elif "recordings" in given:
            allowed += f", before {named}"
        raise ArgumentError(f"{named}: is a recording; allowed: {allowed}")
    if config is not None:
        shipped.path_of(config)
    elif not (named in shipped.names() or named.endswith(".toml") or shipped.there(named)):
        raise RunFolderError(
            f"{named}: holds no finished run (result.json is missing), and is no configuration; "
            "allowed: the folder of a run, a TOML file, or a name from `posegsa configs`"
            f"{meant(named.lower(), shipped.names())}"
        )


def _check_recordings(options: argparse.Namespace) -> None:
    """Refuse recordings that do not exist, before the slow imports.

    Of several whose results do not depend on each other, the command itself refuses each.
    """
    given = vars(options)
    needed = [
        path
        for name in ("recording", "held_out", "training")
        for path in ([given[name]] if isinstance(given.get(name), str) else given.get(name) or [])
    ]
    if not any(Path(path).exists() for path in given.get("recordings", [])):
        needed += given.get("recordings", [])
    if missing := [path for path in needed if not Path(path).exists()]:
        raise RecordingError(f"{', '.join(missing)}: there is no such file or folder")


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line. It does not make the commands' slow imports."""
    parser = Parser(
        prog="posegsa",
        description="Tunes filters for the pose of a rigid body; judges, replays and exports them.",
    )
    parser.add_argument("--version", action="version", version=f"posegsa {VERSION}")
    commands = parser.add_subparsers(title="commands", required=True)
    for command in (tune, evaluate, replay, check, export, compare, sweep, configs):
        command.add(commands)
    return parser


def _say_stopping() -> None:
    say("posegsa: stopping; repeat the signal to stop at once (keeps only the last checkpoint)")


def _say_stopped(how: str) -> None:
    say(f"posegsa: {how}")


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    if issubclass(category, PosegsaWarning):
        say(f"note: {message}")
    else:
        sys.stderr.write(warnings.formatwarning(message, category, filename, lineno, line))
