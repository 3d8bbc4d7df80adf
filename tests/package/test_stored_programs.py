"""Stored programs: found again by what they depend on and nothing else, and never in the way."""

import pickle
import subprocess
import sys
import time
from dataclasses import dataclass, field
from functools import partial, wraps
from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.experiments import tiny
from jax import random

from posegsa import stored_programs
from posegsa.judging.metrics import _begin, _onward, error_tracks
from posegsa.model.rollout import simulate
from posegsa.model.se3 import rotation_matrix
from posegsa.optimisers import GSA
from posegsa.optimisers.driver import _advance
from posegsa.optimisers.loop import _stored_start
from posegsa.search.build import _drawn, tuning_problem
from posegsa.search.run import run_search
from posegsa.stored_programs import StoredFunction, store_in, stored


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Given:
    numbers: jax.Array
    power: int = field(metadata={"static": True})


def to_power(given, times):
    return {"result": times * given.numbers**given.power}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Programs are stored here; functions of this file count as posegsa's own."""
    here = {one.__name__: one for one in (to_power, Given, drawn_with)}
    monkeypatch.setitem(sys.modules, "posegsa.tests", SimpleNamespace(**here))
    for one in here.values():
        monkeypatch.setattr(one, "__module__", "posegsa.tests")
    store_in(tmp_path)
    yield tmp_path
    store_in(None)


def anew(function=to_power, **options) -> StoredFunction:
    """The function as another process has it: nothing is known of what this one compiled."""
    return stored(function, **options)


def programs(folder) -> list:
    return sorted(folder.glob("*.program"))


def drawn_with(key, count):
    return random.normal(key, (count,)), random.fold_in(key, 1)


def test_a_program_is_loaded_and_gives_the_same_bits(folder, monkeypatch):
    given = Given(jnp.asarray([0.1, 2.0, np.inf]), 3)
    first = anew()(given, 0.3)
    assert len(programs(folder)) == 1

    def fail(*_):
        raise AssertionError("compiled again")

    monkeypatch.setattr(stored_programs, "_compiled", fail)
    again = anew()(given, 0.3)
    np.testing.assert_array_equal(first["result"], again["result"])
    # Another number of the same kind needs no other program.
    np.testing.assert_array_equal(anew()(given, 2.0)["result"], 2 * given.numbers**3)


@pytest.mark.parametrize(
    "other",
    [
        (Given(jnp.ones(3), 2), 0.3),
        (Given(jnp.ones(4), 3), 0.3),
        (Given(jnp.ones(3, jnp.int32), 3), 1),
        (Given(jnp.ones(3), 3), np.float32(0.3)),
    ],
    ids=["structure", "shape", "dtype", "kind of number"],
)
def test_what_differs_has_its_own_program(folder, other):
    anew()(Given(jnp.ones(3), 3), 0.3)
    anew()(*other)
    assert len(programs(folder)) == 2


def test_precision_and_options_have_their_own_program(folder):
    given = Given(np.ones(3, np.float32), 3)
    anew()(given, np.float32(1))
    with jax.enable_x64(True):
        anew()(given, np.float32(1))
    with jax.numpy_dtype_promotion("standard"):
        anew()(given, np.float32(1))
    assert len(programs(folder)) == 3


def test_keys_and_static_arguments(folder):
    run = partial(anew, drawn_with, static_argnums=(1,))
    normals, key = run()(random.key(3), 4)
    again, same = run()(random.key(3), 4)
    np.testing.assert_array_equal(normals, again)
    np.testing.assert_array_equal(random.key_data(key), random.key_data(same))
    run()(random.key(3), 5)
    assert len(programs(folder)) == 2


def test_arrays_on_several_devices(folder):
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:2]), ("devices",))
    everywhere = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())
    given = jax.device_put(Given(jnp.arange(3.0), 2), everywhere)
    first, again = anew()(given, 1.0)["result"], anew()(given, 1.0)["result"]
    np.testing.assert_array_equal(first, again)
    assert again.sharding.device_set == first.sharding.device_set
    anew()(Given(jnp.arange(3.0), 2), 1.0)
    assert len(programs(folder)) == 2


@pytest.mark.parametrize("damage", ["cut", "empty", "other", "pickle", "one byte"])
def test_a_damaged_program_is_compiled_anew(folder, damage):
    given = Given(jnp.arange(3.0), 3)
    first = anew()(given, 0.3)["result"]
    (path,) = programs(folder)
    whole = path.read_bytes()
    path.write_bytes(
        {
            "cut": whole[: len(whole) // 2],
            "empty": b"",
            "other": b"no program",
            "pickle": pickle.dumps((b"", {})),
            "one byte": whole[:-900] + bytes([whole[-900] ^ 1]) + whole[-899:],
        }[damage]
    )
    np.testing.assert_array_equal(anew()(given, 0.3)["result"], first)
    assert len(path.read_bytes()) == len(whole)


def test_functions_of_others_are_not_stored(folder, monkeypatch):
    """A user's function may change while its name stays."""
    own = StoredFunction(lambda given, cost: cost(given), (1,))
    assert own(jnp.asarray(2.0), jnp.sin) == pytest.approx(np.sin(2))
    monkeypatch.setattr(to_power, "__module__", "somebody")
    anew()(Given(jnp.ones(3), 3), 0.3)
    assert programs(folder) == []


def test_inside_other_programs_and_without_a_folder():
    given = Given(jnp.arange(3.0), 3)
    plain = anew()
    np.testing.assert_array_equal(
        jax.jit(lambda x: plain(Given(x, 3), 2.0)["result"])(given.numbers),
        plain(given, 2.0)["result"],
    )
    np.testing.assert_array_equal(plain(given=given, times=2.0)["result"], 2 * given.numbers**3)


def test_a_folder_that_cannot_be_written(folder):
    folder.rmdir()
    given = Given(jnp.arange(3.0), 3)
    np.testing.assert_array_equal(anew()(given, 2.0)["result"], 2 * given.numbers**3)


def test_programs_that_nobody_uses_are_forgotten(folder, monkeypatch):
    anew()(Given(jnp.ones(3), 3), 0.3)
    store_in(folder)
    assert len(programs(folder)) == 1
    later = time.time() + 31 * 24 * 3600
    monkeypatch.setattr(time, "time", lambda: later)
    store_in(folder)
    assert programs(folder) == []


def test_words_tell_structures_apart():
    def words(value) -> str:
        return stored_programs._words(value)

    assert words(GSA(agents=10)) != words(GSA(agents=11))
    assert words(GSA(g0=0.1)) != words(GSA(g0=float(np.float32(0.1))))
    assert words((1, 2)) != words([1, 2])
    assert words(1) != words(1.0) != words(True)
    assert words(rotation_matrix) == "posegsa.model.se3.rotation_matrix"
    assert words(partial(rotation_matrix, 1)) != words(partial(rotation_matrix, 2))
    with pytest.raises(stored_programs._CannotSay):
        words(object())
    with pytest.raises(stored_programs._CannotSay):
        words(lambda x: x)
    with pytest.raises(stored_programs._CannotSay):
        words([].append)

    @wraps(rotation_matrix)
    def of_a_user(x):
        return 2 * x

    with pytest.raises(stored_programs._CannotSay):
        words(of_a_user)


def test_a_program_that_cannot_be_run_after_all_is_forgotten(folder, monkeypatch):
    given = Given(jnp.ones(3), 3)
    anew()(given, 0.3)

    def broken(*_):
        def run(*_):
            raise jax.errors.JaxRuntimeError("INTERNAL: Function not found")

        return run

    monkeypatch.setattr(stored_programs, "_load", broken)
    again = anew()
    for _ in range(2):
        np.testing.assert_array_equal(again(given, 2.0)["result"], 2 * given.numbers)
    assert programs(folder) == []


@pytest.mark.parametrize(
    "option",
    [
        partial(jax.default_device, jax.devices()[1]),
        partial(jax.debug_nans, True),
        partial(jax.disable_jit, True),
    ],
    ids=["device", "NaN", "no jit"],
)
def test_options_under_which_nothing_is_stored(folder, option):
    given = Given(np.ones(3, np.float32), 3)
    with option():
        found = anew()(given, np.float32(2))["result"]
    np.testing.assert_array_equal(found, 2 * given.numbers)
    assert programs(folder) == []


def test_code_that_has_changed_under_the_process_is_not_stored(folder, monkeypatch):
    monkeypatch.setattr(stored_programs, "_SOURCE", [])
    anew()(Given(jnp.ones(3), 3), 0.3)
    assert programs(folder) == []


def test_options_that_xla_may_not_have_read(folder, monkeypatch):
    stored_programs._here.cache_clear()
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_prefer_vector_width=128")
    anew()(Given(jnp.ones(3), 3), 0.3)
    assert programs(folder) == []


def test_a_full_disk_leaves_nothing_behind(folder, monkeypatch):
    def full(path, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(type(folder), "replace", full)
    anew()(Given(jnp.ones(3), 3), 0.3)
    assert list(folder.iterdir()) == []


def test_a_program_that_is_another_users_is_used_all_the_same(folder, monkeypatch):
    given = Given(jnp.ones(3), 3)
    anew()(given, 0.3)

    def refuse(*_):
        raise PermissionError

    monkeypatch.setattr(stored_programs.os, "utime", refuse)
    monkeypatch.setattr(stored_programs, "_compiled", refuse)
    np.testing.assert_array_equal(anew()(given, 2.0)["result"], 2 * given.numbers)


def test_stored_functions_are_pickled_by_name():
    assert pickle.loads(pickle.dumps(simulate)) is simulate


SMALL = (
    *("search.agents=64", "search.optimiser=random_search"),
    *("filter.substeps=1", "filter.cross_vector=false", "run.held_out_scenarios=2"),
)
"""Settings whose programs are compiled soon."""


def test_a_search_is_the_same_compiled_stored_and_loaded(tmp_path):
    """The programs of a whole search and of what judges it, on two devices."""

    functions = [cast(Any, f) for f in (_advance, _drawn, _stored_start, _begin, _onward)]

    def run():
        # As another process has them: nothing is known of what this one compiled.
        for one in functions:
            one._programs.clear()
        problem = tuning_problem(tiny(*SMALL))
        search = run_search(problem).search
        return search, error_tracks(problem.space.candidate(search.best_position), problem.held_out)

    for one in functions:
        one._jitted.clear_cache()  # what JAX's own cache had can't be stored
    store_in(tmp_path)
    try:
        cold, loaded = run(), run()
        unstored = [f for f in functions if f._jitted in f._programs.values() or not f._programs]
    finally:
        store_in(None)
    plain = run()
    assert unstored == []
    for other in (cold, loaded):
        for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(other), strict=True):
            both = (a, b) if not jnp.issubdtype(a.dtype, jax.dtypes.prng_key) else ()
            if both:
                np.testing.assert_array_equal(*both)


PROCESS = """
import sys
from pathlib import Path
import jax
from posegsa import stored_programs
from posegsa.search.keys import scenario_keys
traced = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, _, **about: traced.append(about.get("fun_name")) if "trace" in event else None
)
stored_programs.store_in(Path(sys.argv[1]))
keys = scenario_keys(jax.random.key(1), 3)
print("scenario_keys" in traced, jax.random.key_data(keys).tolist())
"""


def test_another_process_traces_nothing(tmp_path):
    said = [
        subprocess.run(
            [sys.executable, "-c", PROCESS, str(tmp_path)],
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        ).stdout.split(maxsplit=1)
        for _ in range(2)
    ]
    assert [traced for traced, _ in said] == ["True", "False"]
    assert said[0][1] == said[1][1]
