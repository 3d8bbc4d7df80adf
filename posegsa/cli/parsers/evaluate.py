"""What can be typed after `posegsa evaluate`."""

from posegsa.cli.parsers.arguments import (
    RECORDING,
    add_bridge,
    add_figures,
    add_quiet,
    add_window,
    whole_number,
    window,
)


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "evaluate",
        help="judge a finished run on more unseen scenarios or recordings, beside baselines",
        description="Judges a finished run on unseen scenarios beside the best constant gain, "
        "a time switch and other schedules searched with as many evaluations, and Kalman filters; "
        "minutes. "
        "Writes evaluation.json, evaluation.txt, figures and report.html to the run's folder, and "
        "the held-out means in its result.json. "
        "With --recording it judges the run on recordings instead, beside the best constant gains "
        "and a Kalman filter, and writes recorded.json and recorded.txt.",
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    scenarios = "number of held-out scenarios (default: 1000)"
    parser.add_argument("--scenarios", type=whole_number(2), metavar="S", help=scenarios)
    seed = "another held-out set than the run's own; any whole number from 0"
    parser.add_argument("--seed", type=whole_number(0), metavar="N", help=seed)
    add_figures(parser)
    add_quiet(parser)
    group = parser.add_argument_group(
        "recordings", "Judges a run on recorded motion, whatever it was tuned on."
    )
    group.add_argument("--recording", metavar="FILE", action="append", help=RECORDING)
    add_window(group)
    add_bridge(group)
    words = (
        "of a run that was tuned on recordings, one of these: constant gains and the Kalman filter "
        "are tuned on them (without any, both are left out)"
    )
    group.add_argument("--training", metavar="FILE", action="append", help=words)
    words = "the same as --window of those"
    group.add_argument("--training-window", metavar="A:B", type=window, help=words)
    parser.set_defaults(command="evaluate")
