"""A checkpoint is one file: it restores exactly what was saved, or is refused."""

import json
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.arrays import assert_same

from posegsa.errors import CheckpointError, DamagedCheckpointError
from posegsa.optimisers import (
    GSA,
    PolishedGSA,
    RandomSearch,
    advance,
    box,
    lengthened,
    minimise,
    start,
)
from posegsa.saving.checkpoint import FORMAT, load_search, read, save_search

BOX = box([-1.0, -1.0], [1.0, 2.0])
SMALL = GSA(agents=5, iterations=7)
KEY = jax.random.key(1)


def sphere(x):
    return jnp.sum(x**2, axis=1)


@pytest.fixture(scope="module")
def whole():
    """A finished search, and its state in the callback after each iteration."""
    seen = []
    return minimise(sphere, BOX, SMALL, KEY, chunk=1, callback=seen.append), seen


@pytest.fixture
def saved(whole, tmp_path):
    path = tmp_path / "one.checkpoint"
    save_search(path, whole[1][2], {"note": "third"})
    return path


def test_a_search_comes_back_bit_for_bit(whole, saved):
    assert_same(load_search(saved, start(SMALL, BOX, KEY)), whole[1][2])
    assert read(saved).about == {"note": "third"}
    assert not list(saved.parent.glob("*.part"))


@pytest.mark.parametrize("interrupted_at", range(7))
def test_resuming_from_a_file_equals_never_having_stopped(whole, tmp_path, interrupted_at):
    finished, seen = whole
    path = tmp_path / "search"
    save_search(path, seen[interrupted_at])
    loaded = load_search(path, start(SMALL, BOX, jax.random.key(99)))
    assert_same(minimise(sphere, BOX, SMALL, KEY, chunk=3, search=loaded), finished)


def test_a_search_without_any_finite_cost_is_kept_as_that(tmp_path):
    far = box([2.0**80, 2.0**80], [2.0**82, 3 * 2.0**80])  # their squares overflow in float32
    seen = []
    finished = minimise(sphere, far, SMALL, KEY, chunk=4, callback=seen.append)
    save_search(tmp_path / "search", seen[0])
    loaded = load_search(tmp_path / "search", finished)
    assert_same(minimise(sphere, far, SMALL, KEY, search=loaded), finished)
    assert finished.best_cost == np.inf
    assert int(finished.non_finite) == 35
    assert finished.best_position.tolist() == [2.5 * 2.0**80, 2.0**81], "the middle of the box"


def test_random_search_and_float64_likewise(tmp_path, x64):
    optimiser, path = RandomSearch(agents=3, iterations=4), tmp_path / "search"
    wide = box(np.zeros(3), np.ones(3))
    half = advance(optimiser, sphere, wide, start(optimiser, wide, KEY), 2)
    save_search(path, half)
    loaded = load_search(path, start(optimiser, wide, KEY))
    assert loaded.best_position.dtype == np.float64
    assert_same(loaded, half)


def test_a_search_of_several_phases_resumes_from_any_of_them(tmp_path):
    polish, seen = PolishedGSA(agents=5, iterations=40, share=0.9, starts=2), []
    whole = minimise(sphere, BOX, polish, KEY, chunk=1, callback=seen.append)
    assert [phase.iterations for phase in polish.phases] == [4, 3]
    for search in seen:
        save_search(tmp_path / "search", search)
        loaded = load_search(tmp_path / "search", start(polish, BOX, KEY))
        assert_same(minimise(sphere, BOX, polish, KEY, search=loaded), whole)


def test_an_optimiser_with_old_style_keys_and_a_state_of_its_own(tmp_path):
    like = start(SMALL, BOX, KEY)._replace(
        state={"key": jax.random.PRNGKey(3), "memory": [jnp.arange(4), jnp.zeros(0)]}
    )
    save_search(tmp_path / "search", like)
    assert_same(load_search(tmp_path / "search", like), like)


def test_more_iterations_are_room_in_the_history(whole):
    finished, seen = whole
    longer = GSA(agents=5, iterations=9, decay_iterations=7)
    extended = minimise(sphere, BOX, longer, KEY, search=lengthened(finished, 9))
    assert_same(extended, minimise(sphere, BOX, longer, KEY, search=lengthened(seen[3], 9)))
    assert (extended.history.best[:7] == finished.history.best).all()
    assert_same(extended, minimise(sphere, BOX, longer, KEY))  # the same from the start
    gravity, k_best = longer.schedule()
    assert (gravity[6:] == SMALL.schedule()[0][-1]).all()
    assert (k_best[6:] == SMALL.schedule()[1][-1]).all()
    with pytest.raises(ValueError, match="further iterations = -2"):
        lengthened(finished, 5)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (lambda: start(GSA(agents=6, iterations=7), BOX, KEY), r"\.position has shape \(5, 2\)"),
        (lambda: start(GSA(agents=5, iterations=8), BOX, KEY), r"\.best has shape \(7,\)"),
        (lambda: start(SMALL, box([0.0], [1.0]), KEY), r"best_position has shape|\.position has"),
        (lambda: start(RandomSearch(agents=5, iterations=7), BOX, KEY), r"has \.state\.velocity"),
        (lambda: start(SMALL, BOX, jax.random.PRNGKey(1)), r"\.state\.key is key<fry>"),
        (lambda: 5, "like: a int"),
    ],
)
def test_another_structure_is_refused_by_what_differs(saved, other, said):
    with pytest.raises(CheckpointError, match=said):
        load_search(saved, other())


def test_another_dtype_is_refused(saved, x64):
    wide = box(np.array([-1.0, -1.0]), np.array([1.0, 2.0]))
    with pytest.raises(CheckpointError, match=r"is float32.*float64"):
        load_search(saved, start(SMALL, wide, KEY))


def test_every_cut_and_every_changed_byte_is_seen(saved):
    """Every byte is damaged once; the benchmark does this thousands of times."""
    whole_file = saved.read_bytes()
    rng = np.random.default_rng(0)
    for i in range(len(whole_file)):
        changed = bytearray(whole_file)
        changed[i] ^= 1 << rng.integers(8)
        saved.write_bytes(changed)
        with pytest.raises(DamagedCheckpointError):
            read(saved)
    for length in {0, 1, 18, 19, 20, 83, 84, 85, len(whole_file) - 1} | set(
        rng.integers(0, len(whole_file), 50).tolist()
    ):
        saved.write_bytes(whole_file[:length])
        with pytest.raises(DamagedCheckpointError):
            read(saved)
    saved.write_bytes(whole_file + b"\0")
    with pytest.raises(DamagedCheckpointError):
        read(saved)


def forged(path, header: dict, payload: bytes = b"") -> None:
    """A file with a correct checksum: manipulated, not damaged."""
    import hashlib

    content = json.dumps(header).encode() + b"\n" + payload
    digest = hashlib.sha256(content).hexdigest().encode()
    path.write_bytes(b"posegsa checkpoint\n" + digest + b"\n" + content)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ({"format": FORMAT + 1, "about": {}, "arrays": []}, f"format {FORMAT + 1}"),
        ({"about": {}, "arrays": []}, "posegsa"),
        ({"format": FORMAT, "about": {}, "arrays": [["x", "f", "float32"]]}, "not as"),
        ({"format": FORMAT, "about": {}, "arrays": [["x", "f", "float32", 3]]}, "not as"),
        ({"format": FORMAT, "about": {}, "arrays": [[["x"], "f", "float32", []]]}, "not as"),
        ({"format": FORMAT, "about": [3], "arrays": []}, "not as"),
        ([], "not as"),
    ],
)
def test_a_forged_header_allocates_nothing_and_runs_nothing(tmp_path, header, said):
    path = tmp_path / "forged"
    forged(path, header)
    with pytest.raises(CheckpointError, match=said):
        read(path)


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        *((2, stored, "is stored as") for stored in ("int32", "S4", "object", "f4,(2", 3, None)),
        *((3, shape, "has shape") for shape in ([2**60], [-1], [1], ["x"], "x")),
        (1, "float64", "is"),
    ],
)
def test_an_arrays_header_must_match_what_is_needed(saved, place, value, said):
    like = start(SMALL, BOX, KEY)
    header, payload = saved.read_bytes().split(b"\n", 3)[2:]
    forging = json.loads(header)
    (best,) = (array for array in forging["arrays"] if array[0] == ".best_cost")
    assert best[1:3] == ["float32", "float32"]
    best[place] = value
    forged(saved, forging, payload)
    with pytest.raises(CheckpointError, match=rf"\.best_cost {said} .*needed"):
        load_search(saved, like)


def test_bytes_that_do_not_fit_the_arrays_are_refused(saved):
    like = start(SMALL, BOX, KEY)
    header, payload = saved.read_bytes().split(b"\n", 3)[2:]
    for other, said in ((payload[:-1], "no bytes"), (payload + b"0", "1 bytes")):
        forged(saved, json.loads(header), other)
        with pytest.raises(CheckpointError, match=said):
            load_search(saved, like)


def test_an_object_that_is_not_an_array_is_refused_by_name(whole, tmp_path):
    odd = whole[0]._replace(state={"strategy": (object(), 1.0)})
    with pytest.raises(CheckpointError, match=r"search\.state\['strategy'\]\[0\] is a object"):
        save_search(tmp_path / "search", odd)
    assert not any(tmp_path.iterdir())
    save_search(tmp_path / "search", whole[0])
    with pytest.raises(CheckpointError, match=r"like\.state\['strategy'\]\[0\] is a object"):
        load_search(tmp_path / "search", odd)


def test_what_cannot_be_read_or_is_too_large_is_refused(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(CheckpointError, match="cannot be read"):
            read(path)
    sparse = tmp_path / "sparse"
    with sparse.open("wb") as file:
        file.truncate(2**31 + 1)  # sparse: takes no space on the disk
    with pytest.raises(CheckpointError, match=r"2147483649 bytes; allowed"):
        read(sparse)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CheckpointError, match="not a regular file"):
        read(tmp_path / "pipe")


def test_what_cannot_be_written_leaves_the_old_file(whole, saved):
    before = saved.read_bytes()
    with pytest.raises(CheckpointError, match="search: a int"):
        save_search(saved, 5)
    with pytest.raises(CheckpointError, match="cannot be written"):
        save_search(saved / "below", whole[0])
    assert saved.read_bytes() == before


def test_minimise_refuses_a_search_of_another_optimiser(whole):
    for other, said in (
        (start(GSA(agents=6, iterations=7), BOX, KEY), r"search\.state\.position is float32"),
        (start(RandomSearch(agents=5, iterations=7), BOX, KEY), "of this optimiser"),
    ):
        with pytest.raises(ValueError, match=said):
            minimise(sphere, BOX, SMALL, KEY, search=other)
