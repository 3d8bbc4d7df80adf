"""What can be typed after `posegsa tune`."""

from typing import get_args

from posegsa.cli.parsers.arguments import (
    RECORDING,
    add_bridge,
    add_figures,
    add_imu,
    add_search_arguments,
    add_window,
    window,
)
from posegsa.search.recorded_schedules import RecordedSchedule

OUT = "posegsa-run"
"""Folder that is written to where none is given."""
FILES = "report.html, result.json, evaluation.json, .txt, history.csv, trajectory.csv"


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "tune",
        help="tune a gain schedule and judge it on unseen scenarios",
        description="Tunes a gain schedule and judges it on scenarios it was not tuned on. Writes "
        f"{FILES}, figures/ to a folder; on recordings (--recording) recorded.json and "
        "recorded.txt instead.",
    )
    add_search_arguments(
        parser,
        config="the recommended experiment, or that of the run to resume",
        setting="filter.substeps=4",
        out=f"folder to write to, checkpoints too (default: {OUT})",
        replaced="the run that the folder holds",
    )
    add_figures(parser)
    resume = (
        "go on with the run in this folder; a CONFIG or settings must be those of the run, but for "
        "more iterations, and so must recordings"
    )
    parser.add_argument("--resume", metavar="DIR", help=resume)
    parser.add_argument("--iterations", type=int, metavar="N", help="replaces search.iterations")
    parser.add_argument("--seed", type=int, metavar="N", help="replaces run.seed")
    group = parser.add_argument_group(
        "recordings", "Tunes on recorded motion instead of simulated scenarios."
    )
    group.add_argument("--recording", metavar="FILE", action="append", help=RECORDING)
    group.add_argument("--held-out", metavar="FILE", action="append", help="one that only judges")
    add_window(group)
    group.add_argument(
        "--held-out-window", metavar="A:B", type=window, help="the same of those that only judge"
    )
    add_bridge(group)
    add_imu(group)
    group.add_argument(
        "--schedule",
        choices=get_args(RecordedSchedule),
        help="what is searched: k1 to k22 (default), one gain, or K(e) of three numbers",
    )
    together = parser.add_argument_group(
        "several processes",
        "The same command in each, on one machine or many; the first writes the files. Without "
        "addresses, JAX asks the cluster (Slurm, Open MPI, Kubernetes and others).",
    )
    together.add_argument("--distributed", action="store_true", help="search together")
    waits = "where the first waits for the others"
    together.add_argument("--coordinator", metavar="HOST:PORT", help=waits)
    together.add_argument("--processes", type=int, metavar="N", help="how many they are")
    together.add_argument("--process", type=int, metavar="I", help="which one this is, from 0")
    parser.set_defaults(command="tune")
