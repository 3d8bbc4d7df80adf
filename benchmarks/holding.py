"""Whether the tuned observer stays accurate: over long times, at rest, and after motion.

Each row is a ratio or an error of one tuned run on scenarios that were not used for tuning:

1. Ten minutes at rest at random attitudes, from initial errors of 30 degrees and 1 m: the attitude
   error over the last minute, compared with the same gains without learning the vector biases.
2. Two minutes of rest after one minute of motion: the last minute of the rest, compared with the
   last 20 s of the motion.
3. Long duration: eight times as long as the tuning scenarios.
4. The time of a population's step with the learning of vector biases, compared with that without.
5. Without noise, in float64: errors of pose and biases after five minutes.

    python benchmarks/holding.py [--run FOLDER] [--write]
"""

import argparse
import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np
from readme import write_block
from scipy.spatial.transform import Rotation

import posegsa
from posegsa import config
from posegsa.filters.rollout import ErrorTrack
from posegsa.judging.metrics import error_tracks
from posegsa.judging.result import Result
from posegsa.runtime import environment
from posegsa.saving.result_files import load
from posegsa.search.candidates import Candidate
from posegsa.search.drawn_scenarios import scenario_batch
from posegsa.search.keys import endurance_keys
from posegsa.search.population import evaluate_population
from posegsa.search.problem import tuning_problem
from posegsa.search.search_spaces import parameter_space

ATTITUDES, EACH = 8, 4
"""Number of random attitudes at rest, and of scenarios with each."""
LAW_OFF = ["filter.vector_bias=off", "parameters.also=[]"]


def tracks(experiment: config.Experiment, candidate: Candidate, scenarios: int) -> ErrorTrack:
    """Errors of a candidate on unseen scenarios of an experiment."""
    keys = endurance_keys(experiment.run.seed, scenarios)
    return error_tracks(candidate, scenario_batch(experiment, keys))


def degrees(track: ErrorTrack) -> np.ndarray:
    """Attitude errors [deg]."""
    half = np.sqrt(np.clip(np.asarray(track.attitude, np.float64), 0, 1))
    return np.degrees(2 * np.arcsin(half))


def rms(errors: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(errors, dtype=np.float64))))


def lasting(duration: float) -> list[str]:
    """Settings for scenarios of a given duration [s]."""
    return [f"scenario.duration={duration}"]


def rest(result: Result) -> tuple[float, float]:
    """Attitude RMS [deg] over the last of ten minutes at rest, with and without learning."""
    tuned, gains = result.tuned, Candidate(result.schedule)
    found = []
    for law in ([], LAW_OFF):
        squares = []
        for i in range(ATTITUDES):
            rotation = Rotation.random(rng=np.random.default_rng(i)).as_matrix().tolist()
            settings = [
                *lasting(600.0),
                f"run.seed={i}",
                f"scenario.initial_rotation={rotation}",
                "scenario.rest=[[0.0, 600.0]]",
                "family.attitude_error=[30.0, 30.0]",
                "family.position_error=[1.0, 1.0]",
                *law,
            ]
            track = tracks(config.override(tuned, settings), gains, EACH)
            squares.append(rms(degrees(track)[:, -6000:]) ** 2)
        found.append(float(np.sqrt(np.mean(squares))))
    return found[0], found[1]


def rest_after_motion(result: Result) -> tuple[float, float]:
    """Attitude RMS [deg] over the last of two minutes at rest, and over 20 s before the rest."""
    settings = [*lasting(180.0), "scenario.rest=[[60.0, 180.0]]"]
    angle = degrees(tracks(config.override(result.tuned, settings), Candidate(result.schedule), 32))
    return rms(angle[:, 12000:]), rms(angle[:, 4000:6000])


def without_noise(result: Result) -> dict[str, float]:
    """Largest errors after 300 s without noise, in float64, over 8 scenarios."""
    tuned = result.tuned
    scenario_noises = ("angular_velocity_noise", "velocity_noise")
    sensors = {"vectors": len(tuned.scenario.vectors), "landmarks": len(tuned.scenario.landmarks)}
    settings = [
        *lasting(300.0),
        "run.dtype=float64",
        *(f"scenario.{name}=0.0" for name in scenario_noises),
        *(f"scenario.{kind}.{i}.noise=0.0" for kind, n in sensors.items() for i in range(n)),
    ]
    experiment = config.override(tuned, settings)
    with jax.enable_x64(True):
        schedule = parameter_space(experiment).schedule(jnp.asarray(result.parameters))
        keys = endurance_keys(experiment.run.seed, 8)
        batch = scenario_batch(experiment, keys)
        track = error_tracks(Candidate(schedule), batch)
        return {
            "rad": float(np.radians(degrees(track)[:, -1].max())),
            "m": float(track.position[:, -1].max()),
            "velocities' biases [rad/s, m/s]": float(np.abs(track.bias - batch.bias).max()),
            "vectors' biases": float(np.abs(track.vector_bias - batch.vector_bias).max()),
        }


def step_ratio(result: Result, repetitions: int = 7) -> tuple[float, float]:
    """Best time [s] of 100 agents on 8 scenarios of 15 s, with and without learning vector biases.

    The same agents, by turns.
    """
    experiment = config.override(
        result.experiment,
        [*lasting(15.0), "cost.steady_window=[400, 1400]", "run.training_scenarios=8"],
    )
    problems = [tuning_problem(experiment), tuning_problem(config.override(experiment, LAW_OFF))]
    runs = []
    for problem in problems:
        box = problem.space.box
        at = jnp.linspace(0.0, 1.0, 100)[:, None]
        agents = box.lower + at * (box.upper - box.lower)
        run = jax.jit(evaluate_population)
        run(agents, problem.training, problem.space).block_until_ready()
        runs.append((run, agents, problem))
    best = [np.inf, np.inf]
    for _ in range(repetitions):
        for i, (run, agents, problem) in enumerate(runs):
            begin = time.perf_counter()
            run(agents, problem.training, problem.space).block_until_ready()
            best[i] = min(best[i], time.perf_counter() - begin)
    return best[0], best[1]


def table(result: Result) -> str:
    """The measurements as a Markdown table."""
    on, off = rest(result)
    still, moving = rest_after_motion(result)
    with_law, without = step_ratio(result)
    rows = [
        ("600 s at rest, attitude over the last 60 s: law on, off", on, off, "°"),
        (
            "120 s of rest after motion, attitude: last 60 s, last 20 s of the motion",
            still,
            moving,
            "°",
        ),
        (
            "population of 100 agents, 8 scenarios of 15 s: law on, off",
            1e3 * with_law,
            1e3 * without,
            " ms",
        ),
    ]
    lines = ["| | first | second | ratio |", "| --- | --- | --- | --- |"]
    lines += [
        f"| {what} | {a:.3g}{unit} | {b:.3g}{unit} | {a / b:.2f} |" for what, a, b, unit in rows
    ]
    lines += ["", "| time | tuned filter | best constant gains |", "| --- | --- | --- |"]
    judged = result.on_scenarios
    assert judged is not None
    assert judged.endurance is not None  # the experiment runs it
    for begin, end, *errors in judged.endurance.rows():
        tuned, constant = (
            f"{attitude:.2f}° {100 * position:.1f} cm"
            for attitude, position, _ in (errors[:3], errors[3:])
        )
        lines.append(f"| {begin:g} to {end:g} s | {tuned} | {constant} |")
    lines += [
        "",
        "Centimetres are of the cost's position error, |P_est - R_err P|, not of |P_est - P|.",
    ]
    errors = without_noise(result)
    said = ", ".join(f"{error:.1e} {unit}" for unit, error in errors.items())
    lines += [
        "",
        f"Without noise, after 300 s, largest errors over 8 scenarios in float64: {said}.",
    ]
    machine = environment()
    lines += [
        "",
        f"By `python benchmarks/holding.py --write` ({machine['device']}, jax {machine['jax']}).",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="Whether the tuned observer holds.")
    parser.add_argument("--run", help="folder of a tuned run instead of a new one")
    parser.add_argument("--write", action="store_true", help="write the tables into docs/filter.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore", posegsa.PosegsaWarning)
    posegsa.enable_fast_path()
    text = table(load(options.run) if options.run else posegsa.tune("observer"))
    print(text)
    if options.write:
        write_block("holding", text, "docs/filter.md")


if __name__ == "__main__":
    main()
