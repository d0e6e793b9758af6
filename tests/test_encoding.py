"""Sources painted by least squares: what can be reached is reached, what must stay stays."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array, hstack

from magiclens.analysis.leaks import leaks
from magiclens.contract.artifacts import BoolArray, FloatArray, Scene, Transport, View
from magiclens.encoding.least_squares import LeastSquaresEncoder, _exposure, _SourceMatrix, _steepness
from magiclens.images import to_display
from test_darts import LENS

SIDE = 24


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def shuffled(seed: int = 0) -> Transport:
    """Every pixel of the picture draws from a source pixel of its own and a little from the next; half stay unseen."""
    rng = np.random.default_rng(seed)
    rows = SIDE * SIDE
    order = rng.permutation(4 * rows)[:rows]
    matrix = csr_array((np.full(rows, 0.8, np.float32), (np.arange(rows), order)), (rows, 4 * rows))
    mixed = csr_array(0.9 * eye_array(rows, dtype=np.float32) + 0.1 * eye_array(rows, k=1, dtype=np.float32))
    return Transport(csr_array(mixed @ matrix), (SIDE, SIDE), (2 * SIDE, 2 * SIDE))


PRODUCT = """
import hashlib
import numpy as np
from numba.core.event import install_recorder
from magiclens.kernels.sparse import times
rng = np.random.default_rng(0)
rows, each = 512, 60
pointers, columns = np.arange(rows + 1, dtype=np.int32) * each, rng.integers(0, rows, rows * each).astype(np.int32)
values, x = rng.random(rows * each).astype(np.float32), rng.random((rows, 1)).astype(np.float32)
with install_recorder("numba:compile") as compilations:
    seen = times(pointers, columns, values, x)
print(hashlib.sha256(seen.tobytes()).hexdigest(), bool(compilations.buffer))
"""


@pytest.mark.tools
def test_the_first_run_on_a_machine_gives_the_same_bytes_as_the_second(tmp_path: Path) -> None:
    """Code that numba has just compiled and the same code from its cache: fastmath would tell them apart."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", PRODUCT]
    said = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    (first, compiled), (second, compiled_again) = (each.stdout.split() for each in said)
    assert (compiled, compiled_again) == ("True", "False")
    assert first == second


def scene(
    rng: np.random.Generator, targets: list[FloatArray], names: list[str], reserved: BoolArray | None = None
) -> Scene:
    given = rng.random((2 * SIDE, 2 * SIDE, targets[0].shape[-1])).astype(np.float32)
    views = [
        View(f"v{k}", given, target, np.array([0.0, 0.0, 440.0]), 0.0, name, f"t{k}")
        for k, (target, name) in enumerate(zip(targets, names, strict=True))
    ]
    return Scene(LENS, tuple(views), reserved)


def picture(rng: np.random.Generator, channels: int = 1) -> FloatArray:
    return rng.random((SIDE, SIDE, channels)).astype(np.float32)


def encoded(given: Scene, transports: list[Transport], **options: object) -> Scene:
    return LeastSquaresEncoder.model_validate(options).encode(given, transports, np.random.default_rng(0))


@pytest.mark.parametrize("channels", [1, 3])
def test_what_can_be_shown_is_shown(rng: np.random.Generator, channels: int) -> None:
    transport = shuffled()
    target = transport.see(rng.random((2 * SIDE, 2 * SIDE, channels)).astype(np.float32)) / 0.85
    (view,) = encoded(scene(rng, [target], ["a"]), [transport], iterations=200, exposure=0.85).views
    seen = transport.see(view.source) / 0.85
    assert abs(to_display(seen) - to_display(target)).max() < 0.02
    assert view.source.shape == (2 * SIDE, 2 * SIDE, channels)


def test_views_that_share_a_source_are_solved_together(rng: np.random.Generator) -> None:
    """Two views draw from different pixels of one source: both are shown."""
    first, targets = shuffled(), [picture(rng), picture(rng)]
    matrix = first.matrix[:, np.random.default_rng(1).permutation(first.matrix.shape[1])]
    clash = set(first.matrix.indices) & set(matrix.indices)
    kept = csr_array(matrix)
    kept.data[np.isin(kept.indices, list(clash))] = 0.0
    second = replace(first, matrix=kept)
    out = encoded(scene(rng, targets, ["a", "a"]), [first, second], iterations=200, exposure=0.7)
    assert out.views[0].source is out.views[1].source
    lit = kept.sum(axis=1).reshape(SIDE, SIDE) > 0.55
    for transport, view, rows in zip((first, second), out.views, (np.ones_like(lit), lit), strict=True):
        seen, wanted = to_display(transport.see(view.source) / 0.7), to_display(view.target)
        assert abs(seen - wanted)[rows].mean() < 0.02


def test_progress_is_the_share_of_sources_that_are_done(rng: np.random.Generator) -> None:
    given, told = scene(rng, [picture(rng), picture(rng), picture(rng)], ["a", "b", "a"]), list[float]()
    LeastSquaresEncoder(iterations=1).encode(given, [shuffled()] * 3, rng, told.append)
    assert told == [0.5, 1.0]


def test_frames_have_sources_of_their_own_and_unseen_pixels_keep_what_was_given(rng: np.random.Generator) -> None:
    transport, given = shuffled(), scene(rng, [picture(rng), picture(rng)], ["a", "b"])
    out = encoded(given, [transport, transport])
    seen = np.zeros(4 * SIDE * SIDE, bool)
    seen[transport.matrix.indices] = True
    a, b = (view.source.ravel() for view in out.views)
    assert (a[seen] != b[seen]).any()
    np.testing.assert_array_equal(a[~seen], given.views[0].source.ravel()[~seen])


@pytest.mark.parametrize("finer", [1, 3])
def test_reserved_pixels_stay_bit_for_bit_and_are_reckoned_with(finer: int, rng: np.random.Generator) -> None:
    """Their raster may be finer than that of a source."""
    reserved = np.zeros((2 * SIDE, 2 * SIDE), bool)
    reserved[: SIDE // 2] = True
    fine = np.kron(reserved, np.ones((finer, finer), bool))
    transport, given = shuffled(), scene(rng, [picture(rng)], ["a"], fine)
    (view,) = encoded(given, [transport], camouflage={"type": "noise"}, bleed="2mm").views
    np.testing.assert_array_equal(view.source[reserved], given.views[0].source[reserved])
    assert (view.source != given.views[0].source)[~reserved].mean() > 0.9


def straight(*shares: float) -> Transport:
    """Every pixel of the picture draws these shares from so many blocks of the source, one below the other."""
    rows = 4 * SIDE * SIDE // len(shares)
    identity = eye_array(rows, dtype=np.float32)
    matrix = csr_array(hstack([np.float32(share) * identity for share in shares]))
    return Transport(matrix, (rows // (2 * SIDE), 2 * SIDE), (2 * SIDE, 2 * SIDE))


def test_what_is_reserved_is_taken_off_what_painted_pixels_have_to_show(rng: np.random.Generator) -> None:
    """Half of what the eye sees comes from pixels that keep their value."""
    reserved = np.zeros((2 * SIDE, 2 * SIDE), bool)
    reserved[: SIDE] = reserved[SIDE + SIDE // 2 :] = True
    transport = straight(0.2, 0.2, 0.4, 0.2)
    lens = scene(rng, [np.full((SIDE, SIDE, 1), 0.5, np.float32)], ["a"], reserved)
    (view,) = encoded(lens, [transport], exposure=1, pull=0, iterations=100).views
    blocks = view.source.reshape(4, -1)
    wanted = (0.5 - 0.2 * (blocks[0] + blocks[1] + blocks[3])) / 0.4
    np.testing.assert_allclose(blocks[2], np.clip(wanted, 0, 1), atol=0.01)


def test_pictures_are_as_bright_as_three_quarters_of_the_lit_pixels_can_be(rng: np.random.Generator) -> None:
    """And never brighter than the target: a lens that gathered light would be given a darker source."""
    target = np.full((2 * SIDE, 2 * SIDE, 1), 0.5, np.float32)
    for share, brightness in ((0.6, 0.3), (1.0, 0.5), (2.0, 0.5)):
        (view,) = encoded(scene(rng, [target], ["a"]), [straight(share)], pull=0).views
        np.testing.assert_allclose(straight(share).see(view.source), brightness, atol=0.01)
    through = np.concatenate([np.zeros(50), np.full(30, 0.4), np.full(70, 0.8)])[:, None]
    assert _exposure(None, through) == pytest.approx(0.4)
    assert _exposure(None, through[::-1][:90]) == pytest.approx(0.8)
    assert _exposure(0.3, through) == 0.3
    assert _exposure(None, np.zeros((5, 1))) == 1.0, "nothing is lit"


def test_pixels_are_pulled_to_what_was_given_only_as_far_as_they_matter_little(rng: np.random.Generator) -> None:
    """The second of two pixels that are seen together lets through a hundredth of the light of the first."""
    target = np.full((SIDE, 2 * SIDE, 1), 0.5, np.float32)
    transport = straight(0.8, 0.008)
    given = scene(rng, [target], ["a"])
    before = given.views[0].source.reshape(2, -1)
    moved = []
    for pull in (0.0, 0.01, 100.0):
        (view,) = encoded(given, [transport], exposure=0.8, pull=pull, iterations=300).views
        moved.append(abs(view.source.reshape(2, -1) - before).mean(axis=1))
    (free, _), (some, little), (none, nothing) = moved
    assert free > 0.2
    assert some > 0.9 * free
    assert little < 0.01
    assert none < 0.01
    assert nothing < 0.01


def test_errors_of_light_are_weighted_by_the_slope_of_the_display_curve() -> None:
    """Down to where the curve would be too steep."""
    light = np.linspace(0.021, 0.99, 50)
    slope = (to_display(light + 1e-3) - to_display(light - 1e-3)) / 2e-3
    np.testing.assert_allclose(_steepness(light), slope, rtol=2e-3)
    np.testing.assert_array_equal(_steepness(np.array([0.0, 0.01])), _steepness(np.array([0.02, 0.02])))


def nesterov(a: FloatArray, want: FloatArray, given: FloatArray, pull: float, steps: int) -> FloatArray:
    """The documented method with dense arrays in double precision; it is not started anew."""
    weight = _steepness(want).astype(float) ** 2
    curvature = a.T @ (weight * a.sum(axis=1, keepdims=True))
    pull = pull * float(np.median(curvature))
    x = y = given
    t = 1.0
    for _ in range(steps):
        slope = a.T @ (weight * (a @ y - want)) + pull * (y - given)
        before, x = x, np.clip(y - slope / (curvature + pull), 0, 1)
        t, earlier = (1 + np.sqrt(1 + 4 * t * t)) / 2, t
        y = x + (earlier - 1) / t * (x - before)
    return x


@pytest.mark.parametrize("steps", [1, 2, 3, 5])
def test_the_first_steps_of_the_solver_are_nesterovs(steps: int, rng: np.random.Generator) -> None:
    rows = 4 * SIDE * SIDE
    blur = csr_array(sum(eye_array(rows, k=k, dtype=np.float32) for k in range(-3, 4)) / np.float32(7))
    transport = Transport(blur, (2 * SIDE, 2 * SIDE), (2 * SIDE, 2 * SIDE))
    given, wanted = rng.uniform(0.3, 0.7, (2, rows, 1)).astype(np.float32)
    encoder = LeastSquaresEncoder(exposure=1, pull=0.3, iterations=steps)
    solved = encoder._solve(_SourceMatrix([transport], None, 0), wanted, given)
    np.testing.assert_allclose(solved, nesterov(blur.toarray().astype(float), wanted, given, 0.3, steps), atol=1e-4)


def test_stored_sources_are_whole_display_values(rng: np.random.Generator) -> None:
    """What is written to a file of 8 bits is what was solved."""
    (view,) = encoded(scene(rng, [picture(rng)], ["a"]), [shuffled()]).views
    seen = np.unique(shuffled().matrix.indices)
    values = to_display(view.source.reshape(-1)[seen]) * 255
    np.testing.assert_allclose(values, np.rint(values), atol=1e-3)


def test_where_nothing_that_is_seen_may_be_painted_the_source_stays(rng: np.random.Generator) -> None:
    seen = np.zeros(4 * SIDE * SIDE, bool)
    seen[shuffled().matrix.indices] = True
    given = scene(rng, [picture(rng)], ["a"], seen.reshape(2 * SIDE, 2 * SIDE))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a median of nothing
        (view,) = encoded(given, [shuffled()], bleed="2mm").views
    np.testing.assert_array_equal(view.source, given.views[0].source)


def test_the_solver_starts_its_acceleration_anew_when_it_overshoots(rng: np.random.Generator) -> None:
    """A blurred view is slow to solve: without that, a hundred steps end fifty times as far from the solution."""
    rows = 4 * SIDE * SIDE
    blur = csr_array(sum(eye_array(rows, k=k, dtype=np.float32) for k in range(-6, 7)) / np.float32(14))
    matrix = _SourceMatrix([Transport(blur, (2 * SIDE, 2 * SIDE), (2 * SIDE, 2 * SIDE))], None, 0)
    given, other = rng.uniform(0.4, 0.6, (2, rows, 1)).astype(np.float32)
    solved, early = (
        LeastSquaresEncoder(exposure=1, pull=0.01, iterations=steps)._solve(matrix, matrix.see(other), given)
        for steps in (800, 100)
    )
    assert abs(early - solved).max() < 1e-4


@pytest.mark.parametrize("bleed_px", [0, 1, 3])
def test_painted_pixels_spread_as_far_as_they_are_told_and_no_farther(
    bleed_px: int, rng: np.random.Generator
) -> None:
    """One block of the source is seen; around it the nearest painted pixel is repeated."""
    seen = np.zeros((2 * SIDE, 2 * SIDE), bool)
    seen[20:28, 20:28] = True
    matrix = csr_array(eye_array(4 * SIDE * SIDE, dtype=np.float32))[np.flatnonzero(seen)]
    transport = Transport(csr_array(matrix), (8, 8), (2 * SIDE, 2 * SIDE))
    given = scene(rng, [rng.random((8, 8, 1)).astype(np.float32)], ["a"])
    bleed = f"{(bleed_px + 0.1) * LENS.source_size_mm / (2 * SIDE)}mm" if bleed_px else "0mm"
    (view,) = encoded(given, [transport], bleed=bleed).views
    (covered,) = encoded(given, [transport], bleed=bleed, camouflage={"type": "flat"}).views
    rows, columns = np.indices(seen.shape)
    nearest = np.clip(rows, 20, 27), np.clip(columns, 20, 27)
    near = np.hypot(rows - nearest[0], columns - nearest[1]) <= bleed_px + 0.1
    for source, beyond in ((view.source, given.views[0].source), (covered.source, np.ones_like(covered.source))):
        np.testing.assert_array_equal(source[near], source[nearest][near])
        np.testing.assert_array_equal(source[~near], beyond[~near])


def test_no_pixel_changes_by_more_than_allowed(rng: np.random.Generator) -> None:
    given = scene(rng, [picture(rng)], ["a"])
    (view,) = encoded(given, [shuffled()], change="10%", camouflage={"type": "flat"}).views
    change = abs(to_display(view.source) - to_display(given.views[0].source))
    assert change.max() <= 0.1 + 1 / 255
    assert change.max() > 0.09


def test_camouflage_covers_what_is_not_seen_and_nothing_else(rng: np.random.Generator) -> None:
    transport, given = shuffled(), scene(rng, [picture(rng)], ["a"])
    assert 0 not in transport.matrix.indices
    bare, covered = (encoded(given, [transport], **o).views[0] for o in ({}, {"camouflage": {"type": "flat"}}))
    seen = np.zeros(4 * SIDE * SIDE, bool)
    seen[transport.matrix.indices] = True
    np.testing.assert_array_equal(covered.source.ravel()[seen], bare.source.ravel()[seen])
    assert (covered.source.ravel()[~seen] == 1).all()


def test_equal_inputs_give_equal_sources(rng: np.random.Generator) -> None:
    transport, given = shuffled(), scene(rng, [picture(rng)], ["a"])
    one, two = (encoded(given, [transport], camouflage={"type": "noise"}).views[0].source for _ in range(2))
    np.testing.assert_array_equal(one, two)


def test_leaks_are_counted() -> None:
    """Four facets of one pixel each; the second also draws a tenth of what the first draws."""
    matrix = csr_array(np.array([[1, 0, 0, 0], [0.1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float32))
    transport = Transport(matrix, (2, 2), (2, 2))
    found = leaks([transport], 2, np.array([[False, False], [False, True]]))
    assert found["overlap_max"] == 2
    assert found["leak"] == pytest.approx(0.1 / 4.1, rel=1e-5)
    assert found["leak_from_reserved"] == pytest.approx(1 / 4.1, rel=1e-5)
    clean = Transport(csr_array(np.eye(4, dtype=np.float32)), (2, 2), (2, 2))
    assert leaks([clean], 2) == {"overlap_max": 1.0, "leak": pytest.approx(0, abs=1e-12)}
