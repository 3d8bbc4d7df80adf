"""A search in processes that have joined: the same bits as in one."""

import os
import socket
import subprocess
import sys

import numpy as np
import pytest
from experiments import TINY, tiny

from posegsa.errors import ArgumentError
from posegsa.search import devices
from posegsa.search.build import tuning_problem
from posegsa.search.run import run_search

pytestmark = pytest.mark.optimised

WORKER = """
import os, sys, warnings
from posegsa.runtime import fast_path_flags
os.environ["XLA_FLAGS"] = fast_path_flags(devices=1)
import jax, numpy as np
from posegsa import config
from posegsa.search import devices
from posegsa.search.run import run_search
from posegsa.search.build import tuning_problem
index, address, *settings = sys.argv[1:]
devices.join_processes(address, 2, int(index))
assert len(jax.devices()) == 2 and len(jax.local_devices()) == 1
warnings.simplefilter("ignore")
mesh = devices.mesh_for(1)
assert mesh.devices.size == 2, "processes that have joined use all devices"
found = run_search(tuning_problem(config.override(config.Experiment(), settings))).search
print("found", np.asarray(found.history.best).tobytes().hex(), float(found.best_cost).hex())
"""


@pytest.mark.filterwarnings("ignore::posegsa.errors.PosegsaWarning")
def test_two_processes_find_what_one_finds():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    running = [
        subprocess.Popen(
            [sys.executable, "-c", WORKER, str(i), address, *TINY],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for i in range(2)
    ]
    try:
        told = [process.communicate(timeout=180) for process in running]
    finally:
        for process in running:
            process.kill()
    assert [process.returncode for process in running] == [0, 0], told
    single = run_search(tuning_problem(tiny())).search
    history = np.asarray(single.history.best).tobytes().hex()
    wanted = f"found {history} {float(single.best_cost).hex()}"
    assert [out.splitlines()[-1] for out, _ in told] == [wanted, wanted]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("127.0.0.1:1", None, None), "all three"),
        (("127.0.0.1", 2, 0), "HOST:PORT"),
        (("127.0.0.1:1", 2, 2), "process = 2; allowed: a whole number from 0 to 1"),
        (("127.0.0.1:1", 2, 0.5), "process = 0.5; allowed: a whole number from 0 to 1"),
        (("127.0.0.1:1", 0, 0), "processes = 0; allowed: a whole number from 1"),
        (("127.0.0.1:1", "2", 0), "processes = '2'; allowed: a whole number from 1"),
        (("127.0.0.1:1", True, 0), "processes = True; allowed: a whole number from 1"),
        ((9, 2, 0), "coordinator: a int; allowed: text, HOST:PORT"),
    ],
)
def test_processes_that_cannot_join_are_told_why(given, message):
    with pytest.raises(ArgumentError, match=message):
        devices.join_processes(*given)
