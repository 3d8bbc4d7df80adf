"""A search in processes that have joined: the same bits as in one."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.recordings import motion

from posegsa import config
from posegsa.errors import ArgumentError
from posegsa.recordings.recording import Recording
from posegsa.search import devices
from posegsa.search.recorded import recorded_problem
from posegsa.search.run_search import run_search

pytestmark = pytest.mark.optimised


def found() -> str:
    """The result of a search, to the last bit; one gain and attitude only, to compile quickly."""
    experiment = config.from_dict(
        {
            "filter": {
                **{"schedule": "constant", "vector_bias": "off"},
                **{"cross_vector": False, "substeps": 1},
            },
            "parameters": {"also": []},
            "search": {"optimiser": "random_search", "agents": 11, "iterations": 3},
        }
    )
    attitude = motion(100, velocity=None, landmarks=None, landmark_references=None)
    flight = Recording.from_arrays(name="flight", **attitude)
    recordings = [flight.off(40, seed=seed) for seed in range(3)]  # 33 simulations, an odd number
    search = run_search(recorded_problem(experiment, recordings, 1.0)).search
    history = (search.history.best, search.history.mean, search.history.worst)
    return f"{np.stack(history).tobytes().hex()} {float(search.best_cost).hex()}"


WORKER = """
import os, sys
from posegsa.runtime import fast_path_flags
os.environ["XLA_FLAGS"] = fast_path_flags(devices=1)
import jax
from posegsa.search import devices
index, address, tests = sys.argv[1:]
devices.join_processes(address, 2, int(index))
assert len(jax.devices()) == 2 and len(jax.local_devices()) == 1
mesh = devices.mesh_for(1)
assert mesh.devices.size == 2, "joined processes use all devices"
sys.path[:0] = [tests, tests + "/search"]
from test_joined_processes import found
print("found", found())
"""


def test_two_processes_find_what_one_finds():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    running = [
        subprocess.Popen(
            [sys.executable, "-c", WORKER, str(i), address, str(Path(__file__).parents[1])],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for i in range(2)
    ]
    try:
        outputs = [process.communicate(timeout=180) for process in running]
    finally:
        for process in running:
            process.kill()
    assert [process.returncode for process in running] == [0, 0], outputs
    wanted = f"found {found()}"
    assert [out.splitlines()[-1] for out, _ in outputs] == [wanted, wanted]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("127.0.0.1:1", None, None), "all three"),
        (("127.0.0.1", 2, 0), "HOST:PORT"),
        (("127.0.0.1:1", 2, 2), r"process = 2.*whole number from 0 to 1"),
        (("127.0.0.1:1", 2, 0.5), r"process = 0.5.*whole number from 0 to 1"),
        (("127.0.0.1:1", 0, 0), r"processes = 0.*whole number from 1"),
        (("127.0.0.1:1", "2", 0), r"processes = '2'.*whole number from 1"),
        (("127.0.0.1:1", True, 0), r"processes = True.*whole number from 1"),
        ((9, 2, 0), r"coordinator:.* int.*text, HOST:PORT"),
    ],
)
def test_processes_that_cannot_join_report_why(given, message):
    with pytest.raises(ArgumentError, match=message):
        devices.join_processes(*given)
