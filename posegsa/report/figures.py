"""What each figure of the report is called, shows to who cannot see it, and should tell."""

from collections.abc import Iterable, Mapping

from posegsa.report.markup import Html, element, figure, join

_WORDS = {
    "costs": (
        "Held-out cost",
        "Cost of every contender on every held-out scenario, and mean paired differences",
        "Each point is one scenario; thin bars span 5 to 95\u00a0% of them, thick bars 25 to "
        "75\u00a0%, the stroke is the median and the diamond the mean with its 95\u00a0% interval. "
        "The overlap of the clouds says little, because all contenders met the same scenarios: "
        "look at the paired differences below. An interval that excludes 0 tells two contenders "
        "apart.",
    ),
    "bands": (
        "Errors and gain over time",
        "Median and 5 to 95 % band over scenarios of attitude error, position error and gain",
        "Lines are medians over scenarios, bands span 5 to 95 %. On the left, who gets "
        "out of the initial error first; on the right, who stays lower afterwards. The gain shown "
        "is the one used, after the gain limit. Runs without a finite cost are left out.",
    ),
    "angles": (
        "Cost against initial angle",
        "Held-out cost over the attitude error at the start, with running medians",
        "Points are scenarios, lines running medians. A curve that rises towards 180 deg shows "
        "starts from which the filter takes long to recover; triangles at the upper edge are runs "
        "without a finite cost.",
    ),
    "control_surface": (
        "Control surface",
        "Gain of the tuned schedule over scaled error and scaled rate",
        "The gain that the schedule asks for. Both axes go by the square root, because a filter "
        "spends its time in the lower left corner. Hatched regions have no rule that fires.",
    ),
    "rules": (
        "Use of the rules",
        "Mean firing strength of each of the 25 rules over one held-out trajectory",
        "Rules that never fire had little or no part in the cost: what the schedule does where "
        "they apply is largely chance.",
    ),
    "input_terms": (
        "Input terms",
        "Membership of the five input terms over scaled error and rate",
        "How the scaled error and its rate are read as very small (VS) to very large (VL).",
    ),
    "output_terms": (
        "Output terms",
        "Membership of the five output terms over the controller's output",
        "What the rules ask for; the gain is 1 plus the centroid of these terms as they fire.",
    ),
    "euler_angles": (
        "Attitude",
        "True and estimated roll, pitch and yaw over time",
        "What is left between the curves after the first second comes from the sensors' noise and "
        "biases.",
    ),
    "position": (
        "Position",
        "True and estimated position over time",
        "What is left between the curves after the first second comes from the sensors' noise and "
        "biases.",
    ),
    "errors": (
        "Errors",
        "Attitude and position error over time on logarithmic axes",
        "The fall at the start is the transient part of the cost, the level after it the steady "
        "part.",
    ),
    "gain": (
        "Gain",
        "Gain that the schedule asked for and gain used after the limit, over time",
        "Where the two curves part, the gain limit keeps the filter's step stable. Jumps between "
        "few levels are a schedule that has become a switch.",
    ),
    "convergence": (
        "Convergence",
        "Best, mean and worst training cost over the iterations of the search",
        "A best cost that still falls at the end asks for more iterations. These are training "
        "costs: what they are worth is the held-out cost.",
    ),
}
"""Title, alternative text and caption by name."""

SCHEDULE = ("control_surface", "rules", "input_terms", "output_terms")
ONE_RUN = ("errors", "gain", "euler_angles", "position")
SEARCH = ("convergence",)


def figures(names: Iterable[str], pictures: Mapping[str, bytes]) -> Html:
    """Those of some figures that there are, PNG files by name."""
    shown = [name for name in names if name in pictures]
    drawn = [figure(name, pictures[name], *_WORDS.get(name, (name, name, ""))) for name in shown]
    return element("div", join(drawn, "\n"), class_="figures")
