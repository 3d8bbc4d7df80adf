"""The command line: `posegsa tune`, `evaluate`, `export` and `compare`."""

import argparse
import signal
import sys
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from posegsa.cli.arguments import (
    add_config,
    add_folder,
    add_quiet,
    add_settings,
    whole_number,
)
from posegsa.cli.compare import add_compare
from posegsa.cli.progress import TuneBar
from posegsa.errors import (
    ArgumentError,
    PosegsaError,
    PosegsaWarning,
    SaveError,
    SearchInterrupted,
)
from posegsa.runtime import enable_compilation_cache, enable_fast_path
from posegsa.saving import interrupt

DEFAULT_OUT = "posegsa-run"

# Everything that starts JAX is imported inside the commands, after the fast path is set.


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
            print(f"\nk = {error.result.parameters.tolist()}")
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
    tune = commands.add_parser(
        "tune",
        help="tune a gain schedule and judge it on unseen scenarios",
        description="Tunes a gain schedule and judges it on scenarios it was not tuned on. Writes "
        "report.html, result.json, history.csv, trajectory.csv and figures/ to a folder.",
    )
    add_config(tune, otherwise=", or that of the run to resume")
    add_folder(
        tune,
        f"folder to write to, checkpoints too (default: {DEFAULT_OUT})",
        replaced="the run that the folder holds",
    )
    tune.add_argument(
        "--resume",
        metavar="DIR",
        help="go on with the run in this folder; a CONFIG or settings must be those of the run, "
        "but for more iterations",
    )
    tune.add_argument("--iterations", type=int, metavar="N", help="replaces search.iterations")
    tune.add_argument("--seed", type=int, metavar="N", help="replaces run.seed")
    add_settings(tune, "filter.substeps=4")
    add_quiet(tune)
    together = tune.add_argument_group(
        "several processes",
        "The same command in each, on one machine or many; the first writes the files. Without "
        "addresses, JAX asks the cluster (Slurm, Open MPI, Kubernetes and others).",
    )
    together.add_argument("--distributed", action="store_true", help="search together")
    together.add_argument(
        "--coordinator", metavar="HOST:PORT", help="where the first waits for the others"
    )
    together.add_argument("--processes", type=int, metavar="N", help="how many they are")
    together.add_argument("--process", type=int, metavar="I", help="which one this is, from 0")
    tune.set_defaults(command=_tune)
    evaluate = commands.add_parser(
        "evaluate",
        help="judge a finished run on more unseen scenarios, beside all baselines",
        description="Judges a finished run on unseen scenarios beside the best constant gain, "
        "random search and a smooth schedule with as many evaluations, and an oracle; minutes. "
        "Writes evaluation.json, evaluation.txt, figures and report.html to the run's folder.",
    )
    evaluate.add_argument("run", metavar="RUN", help="folder of a finished run")
    evaluate.add_argument(
        "--scenarios",
        type=whole_number(2),
        default=1000,
        metavar="S",
        help="number of held-out scenarios (default: %(default)s)",
    )
    evaluate.add_argument(
        "--seed",
        type=whole_number(0, 2**31 - 1),
        metavar="N",
        help="another held-out set than the run's own; any whole number from 0",
    )
    evaluate.set_defaults(command=_evaluate)
    export = commands.add_parser(
        "export",
        help="write a tuned schedule as JSON, CSV or C",
        description="Writes the schedule of a finished run: json holds all of it at full "
        "precision, csv the control surface, c a C99 file without dependencies for the gain.",
    )
    export.add_argument("run", metavar="RUN", help="folder of a finished run")
    export.add_argument("--format", choices=("json", "csv", "c"), required=True)
    export.add_argument("--out", metavar="FILE", help="file to write; default standard output")
    export.set_defaults(command=_export)
    add_compare(commands)
    return parser


def _evaluate(options: argparse.Namespace) -> int:
    from posegsa.evaluating import evaluate
    from posegsa.saving.folder import locked_folder
    from posegsa.saving.run import load, write_run

    load(options.run)  # where there is no run, nothing is made
    with locked_folder(options.run, overwrite=True) as folder:  # before the minutes, not after
        result = load(folder)  # again: another process may have replaced it in between
        result = evaluate(result, scenarios=options.scenarios, seed=options.seed, progress=_say)
        write_run(result, folder)
    print(result.evaluation.table())
    print(f"\nWritten to {options.run}: report.html, evaluation.json, evaluation.txt, figures/")
    return 0


def _export(options: argparse.Namespace) -> int:
    from posegsa.export import export
    from posegsa.saving.run import load

    text = export(load(options.run), options.format)
    if options.out is None:
        sys.stdout.write(text)
        return 0
    try:
        Path(options.out).write_text(text, encoding="utf-8")
    except OSError as error:
        raise PosegsaError(f"{options.out}: cannot be written: {error.strerror}") from None
    print(f"Written: {options.out}")
    return 0


def _say(text: str) -> None:
    print(f"{text} ...", file=sys.stderr, flush=True)


def _say_stopping() -> None:
    print(
        "\nposegsa: stopping; again to stop at once (then only the last checkpoint is kept)",
        file=sys.stderr,
        flush=True,
    )


def _tune(options: argparse.Namespace) -> int:
    from posegsa import config
    from posegsa.saving.checkpointing import newest_checkpoint
    from posegsa.tuning import tune

    first = _join(options)
    if options.config is None and options.resume is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PosegsaWarning)  # tune says it again
            experiment = newest_checkpoint(Path(options.resume)).about.experiment
    else:
        experiment = config.as_experiment(options.config)
    settings = list(options.set)
    if options.seed is not None:
        settings.append(f"run.seed={options.seed}")
    if options.iterations is not None:
        settings.append(f"search.iterations={options.iterations}")
    experiment = config.override(experiment, settings)
    out = options.out
    if out is None and options.resume is None:
        out = DEFAULT_OUT
    with TuneBar(experiment.search.iterations, quiet=options.quiet or not first) as show:
        result = tune(
            experiment,
            out=out,
            overwrite=options.overwrite,
            resume=options.resume,
            progress=show,
        )
    if not first:
        return 0
    print(result.summary())
    written = "report.html, result.json, history.csv, trajectory.csv, figures/"
    print(f"\nWritten to {out or options.resume}: {written}")
    return 0


def _join(options: argparse.Namespace) -> bool:
    """Join the other processes, if there are any; whether this is the one that shows and writes."""
    given = {name: getattr(options, name) for name in ("coordinator", "processes", "process")}
    if not options.distributed:
        for name, value in given.items():
            if value is not None:
                raise ArgumentError(f"--{name} = {value}; allowed: with --distributed")
        return True
    import jax

    from posegsa.search.devices import join_processes

    join_processes(**given)
    return jax.process_index() == 0


def _show_warning(message, category, filename, lineno, file=None, line=None) -> None:
    if issubclass(category, PosegsaWarning):
        print(f"note: {message}", file=sys.stderr)
    else:
        sys.stderr.write(warnings.formatwarning(message, category, filename, lineno, line))
