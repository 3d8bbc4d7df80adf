"""The command line: `posegsa tune`, `evaluate`, `replay`, `export`, `compare` and `configs`."""

import argparse
import signal
import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import version

from posegsa.cli import compare, configs, evaluate, export, replay, tune
from posegsa.errors import PosegsaError, PosegsaWarning, SaveError, SearchInterrupted
from posegsa.judging.result import TuneResult
from posegsa.runtime import enable_compilation_cache, enable_fast_path
from posegsa.saving import interrupt


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status.

    0 done, 1 done but not written, 2 refused, 130 interrupted (Ctrl-C), 143 terminated (SIGTERM).
    """
    options = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        # What posegsa has to say is one line for a person, not Python's with file and line number.
        warnings.showwarning = _show_warning
        enable_fast_path()
        enable_compilation_cache()
        try:
            with interrupt.immediate_signals(_say_stopping):
                return options.command(options)
        except SaveError as error:
            # A finished search is worth more than its folder: all that one needs of it is shown.
            print(error.result.summary())
            if isinstance(error.result, TuneResult):
                print(f"\nk = {error.result.parameters.tolist()}")
            else:
                print(f"\n{error.result.filter}")
            print(f"posegsa: {error}", file=sys.stderr)
            return 1
        except PosegsaError as error:
            print(f"posegsa: {error}", file=sys.stderr)
            return 2
        except SearchInterrupted as stopped:
            print(f"\nposegsa: {stopped}", file=sys.stderr)
            return 128 + stopped.signal_number
        except KeyboardInterrupt:
            print("\nposegsa: interrupted", file=sys.stderr)
            return 128 + signal.SIGINT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="posegsa",
        description="Tunes the fuzzy gain schedule of a nonlinear pose filter on SE(3).",
    )
    parser.add_argument("--version", action="version", version=f"posegsa {version('posegsa')}")
    commands = parser.add_subparsers(title="commands", required=True)
    for command in (tune, evaluate, replay, export, compare, configs):
        command.add(commands)
    return parser


def _say_stopping() -> None:
    print(
        "\nposegsa: stopping; again to stop at once (then only the last checkpoint is kept)",
        file=sys.stderr,
        flush=True,
    )


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    if issubclass(category, PosegsaWarning):
        print(f"note: {message}", file=sys.stderr)
    else:
        sys.stderr.write(warnings.formatwarning(message, category, filename, lineno, line))
