"""What can be typed after `posegsa evaluate`."""

from posegsa.cli.parsers.arguments import add_figures, add_quiet, whole_number


def add(commands) -> None:
    """Add the command to the others."""
    parser = commands.add_parser(
        "evaluate",
        help="judge a finished run on more unseen scenarios, beside all baselines",
        description="Judges a finished run on unseen scenarios beside the best constant gain, "
        "a time switch and other schedules searched with as many evaluations, and Kalman filters; "
        "minutes. "
        "Writes evaluation.json, evaluation.txt, figures and report.html to the run's folder.",
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run")
    scenarios = "number of held-out scenarios (default: %(default)s)"
    count = whole_number(2)
    parser.add_argument("--scenarios", type=count, default=1000, metavar="S", help=scenarios)
    seed = "another held-out set than the run's own; any whole number from 0"
    parser.add_argument("--seed", type=whole_number(0), metavar="N", help=seed)
    add_figures(parser)
    add_quiet(parser)
    parser.set_defaults(command="evaluate")
