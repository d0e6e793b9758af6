"""A run that is killed in a long stage goes on in it: what was done is not done again, and the result is the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from magiclens.annealing.heat_bath import HeatBath
from magiclens.cache import unfinished
from magiclens.cache.store import Cache
from magiclens.cache.unfinished import PAUSE_S, Unfinished
from magiclens.cache.values import array_digest
from magiclens.contract.artifacts import Candidates, HeightField, Lens, Scene
from magiclens.contract.errors import Terminated
from magiclens.contract.stages import Progress, silent
from magiclens.integration.poisson import Poisson
from magiclens.integration.through_process import refine_through
from magiclens.kernels import resuming
from magiclens.kernels.resuming import blocks, going_through_loops_by, resumable
from magiclens.matching.exhaustive import Exhaustive
from magiclens.matching.multi_view import MultiViewMatcher
from magiclens.plan.compile import load_plan
from magiclens.processes.linear import LinearProcess
from magiclens.rendering.mitsuba import Mitsuba
from magiclens.running.observers import Observer
from magiclens.running.pipeline import run_plan
from magiclens.testing.scenes import bumpy_solid
from scenes import ABOVE, ASIDE, blotches, choices, grey_view, small_lens, surface
from toys import TOYS, SpecWriter, ToyMatcher, registry_of


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path / "cache", 10**9)


@pytest.fixture
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything is kept at once, and blocks are small."""
    monkeypatch.setattr(unfinished, "PAUSE_S", 0.0)
    monkeypatch.setattr(unfinished, "WORK_PER_WRITING", 0)
    monkeypatch.setattr(resuming, "LEAST_PER_BLOCK", 1)


class Clock:
    """Tells the time that a test sets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.now = 0.0
        monkeypatch.setattr(unfinished, "perf_counter", lambda: self.now)


class Killing:
    """Goes through loops as ``Unfinished`` does, counts items, and kills the stage after so many."""

    def __init__(self, cache: Cache | None, most: float = np.inf, key: str = "stage"):
        self.said: list[str] = []
        self.unfinished = cache and Unfinished(cache, key, "a stage", self.said.append)
        self.items, self._most = 0, most

    def loop(self, count: int, state: Sequence[NDArray[Any]]) -> Iterator[int]:
        for k in self.unfinished.loop(count, state) if self.unfinished else range(count):
            if self.items == self._most:
                raise Terminated
            self.items += 1
            yield k


def entries(cache: Cache) -> list[str]:
    return [entry.step for entry in cache.entries()]


def sums(killing: Killing) -> list[int]:
    """A stage of two loops, the second of which needs what the first has found."""
    total, squares = np.zeros(1, int), np.zeros((5, 1), int)
    with going_through_loops_by(killing.loop):
        for k in resumable(range(10), total):
            total += k
        for k in resumable(range(5), squares):
            squares[k] = total * k
    return [int(total[0]), *map(int, squares.ravel())]


RESULT = [45, 0, 45, 90, 135, 180]


def test_without_a_cache_a_loop_is_an_ordinary_one() -> None:
    assert list(resumable("abc", np.zeros(1))) == ["a", "b", "c"]
    assert sums(Killing(None)) == RESULT


@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("killed_after", range(15))
def test_killed_after_any_item_only_the_others_are_done(cache: Cache, killed_after: int) -> None:
    with pytest.raises(Terminated):
        sums(Killing(cache, killed_after))
    again = Killing(cache)
    assert sums(again) == RESULT
    assert again.items == 15 - killed_after


@pytest.mark.usefixtures("eager")
def test_what_a_finished_stage_has_kept_of_its_loops_is_removed(cache: Cache) -> None:
    with pytest.raises(Terminated):
        sums(Killing(cache, 12))
    assert entries(cache) == ["a stage, unfinished"] * 2
    again = Killing(cache)
    sums(again)
    assert again.unfinished
    again.unfinished.forget()
    assert entries(cache) == []


@pytest.mark.usefixtures("eager")
def test_what_is_damaged_is_done_again_and_said_aloud(cache: Cache) -> None:
    said: list[str] = []
    cache._say = said.append
    with pytest.raises(Terminated):
        sums(Killing(cache, 13))
    for kept in cache.files():
        content = bytearray(kept.path.read_bytes())
        content[len(content) // 2] ^= 1
        kept.path.write_bytes(content)
    again = Killing(cache)
    assert sums(again) == RESULT
    assert again.items == 15
    assert len(said) == 2
    assert all("damaged" in text for text in said)


@pytest.mark.usefixtures("eager")
def test_other_inputs_and_other_loops_begin_anew(cache: Cache) -> None:
    with pytest.raises(Terminated):
        sums(Killing(cache, 13))
    other = Killing(cache, key="of other inputs")
    sums(other)
    assert other.items == 15
    another = Killing(cache)
    with going_through_loops_by(another.loop):
        assert list(resumable(range(9), np.zeros(1, int))) == list(range(9))  # not ten, as before
    another = Killing(cache)
    with going_through_loops_by(another.loop):
        assert list(resumable(range(10), np.zeros(2, int))) == list(range(10))  # another state


def test_short_stages_keep_nothing_and_long_ones_every_ten_seconds(
    cache: Cache, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, state, kept = Clock(monkeypatch), np.zeros(1, int), []
    monkeypatch.setattr(Cache, "keep", lambda _, entry, *__: kept.append((clock.now, entry.facts)))
    long = Unfinished(cache, "key", "stage", lambda _: None)
    for _ in long.loop(8, [state]):
        clock.now += 3.0
    # and at the end, if it was not just before
    assert kept == [(12.0, 4), (24.0, 8)]
    for _ in long.loop(1, [state]):
        clock.now += 1.0
    assert len(kept) == 2


def test_where_writing_is_slow_it_is_done_less_often(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, kept = Clock(monkeypatch), []

    def slowly(_: Cache, entry: Any, *__: Any) -> None:
        kept.append(entry.facts)
        clock.now += 2.0

    monkeypatch.setattr(Cache, "keep", slowly)
    for _ in Unfinished(cache, "key", "stage", lambda _: None).loop(100, [np.zeros(1)]):
        clock.now += 5.0
    assert kept == [2, 42, 82, 100]  # after 10 s, then every 200 s, and at the end
    assert 2.0 * len(kept) < 0.02 * clock.now
    assert PAUSE_S == 10.0


@pytest.mark.parametrize("count", [0, 1, 63, 64, 130, 1024, 16384, 16385])
def test_blocks_hold_every_index_once_and_enough_of_them(count: int) -> None:
    found = blocks(count)
    assert [k for block in found for k in block] == list(range(count))
    assert len(found) == min(16, max(1, count // 64))
    assert all(len(block) >= min(64, count) for block in found)


# ---- the stages


def match_one_eye() -> Any:
    lens = small_lens(3, source=24.0)
    scene = Scene(lens, (grey_view(blotches(96, 4), blotches(48, 3, seed=1)),))
    options = Exhaustive(window="2mm", step="0.5mm", scales=(0.4, 0.7), candidates=4, pixels=8)
    return options.match(scene, np.random.default_rng(0))


def match_two_eyes() -> Any:
    lens = small_lens(3, source=24.0)
    views = tuple(grey_view(blotches(96, 4), blotches(48, 3, seed=k), eye) for k, eye in enumerate((ABOVE, ASIDE)))
    options = MultiViewMatcher(window="2mm", step="0.5mm", scales=(0.4, 0.7), candidates=4, pixels=8)
    return options.match(Scene(lens, views), np.random.default_rng(0))


def anneal() -> Any:
    rng, lens = np.random.default_rng(3), small_lens(5)
    some = choices(rng.normal(size=(5, 5, 6, 2)), np.tile((0.6, 0, 0.6), (5, 5, 6, 1)), rng.random((5, 5, 6)) / 100)
    scene, drawing = Scene(lens, (grey_view(np.ones((16, 16)), np.zeros((16, 16))),)), np.random.default_rng(7)
    return HeatBath(sweeps=6).anneal(scene, some, drawing), drawing.random()


def refine() -> Any:
    lens = small_lens(3, source=24.0)
    scene = Scene(lens, (grey_view(blotches(96, 4), blotches(48, 3, seed=1)),))
    return Poisson(refinement=2).refine(scene, surface(lens, np.zeros((1, 1, 1, 1))))


def refine_as_made() -> Any:
    lens = Lens(size_mm=6.0, source_size_mm=6.0, facets=2, microfacets=8, thickness_mm=12.0, cells="vertical",
                relief_mm=2.0)  # fmt: skip
    scene = Scene(lens, (grey_view(blotches(60, 4), blotches(60, 3, seed=1), (0.0, 0.0, 112.0)),))
    return refine_through(scene, surface(lens, np.zeros((1, 1, 1, 1)), None), LinearProcess(spread="0.1mm"), silent)


def render() -> Any:
    """Eight views, by the variant that rounds alike on every machine."""
    eyes = [(40.0 * k, 0.0, 400.0) for k in range(8)]
    scene = Scene(small_lens(2), tuple(grey_view(blotches(32, 4, seed=k), np.ones((8, 8)), eyes[k]) for k in range(8)))
    return tuple(Mitsuba(resolution=8, samples=4, variant="scalar_rgb").render(scene, bumpy_solid(scene)))


STAGES = {"exhaustive": match_one_eye, "multi-view": match_two_eyes, "heat-bath": anneal, "refinement": refine,
          "refinement as made": refine_as_made, "mitsuba": render}  # fmt: skip


def digests(value: Any) -> list[str]:
    """Of all arrays in a result, and what else it holds."""
    if isinstance(value, np.ndarray):
        return [array_digest(value)]
    if isinstance(value, tuple):
        return [each for part in value for each in digests(part)]
    if isinstance(value, Candidates | HeightField) or hasattr(value, "choice"):
        return [each for part in vars(value).values() for each in digests(part)]
    return [repr(value)]


@pytest.mark.tools
@pytest.mark.usefixtures("eager")
@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_stages_that_are_killed_find_the_same_with_other_numbers_of_threads(
    stage: Callable[[], Any], cache: Cache, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resuming, "MOST_BLOCKS", 3)
    monkeypatch.setattr("magiclens.integration.refinement.FACETS_AT_ONCE", 4)
    monkeypatch.setattr("magiclens.integration.through_process.STEPS_BY_BLUR", (2, 3, 3))
    monkeypatch.setattr("magiclens.integration.through_process.GRADIENT_STEPS", 4)
    expected, whole = digests(stage()), Killing(None)
    with going_through_loops_by(whole.loop):
        assert digests(stage()) == expected
    assert whole.items >= 8
    done = 0
    for kill in range(3):
        monkeypatch.setattr("numba.get_num_threads", lambda kill=kill: (1, 3, 2)[kill])
        killing = Killing(cache, whole.items // 4)
        with pytest.raises(Terminated), going_through_loops_by(killing.loop):
            stage()
        done += killing.items
    again = Killing(cache)
    with going_through_loops_by(again.loop):
        assert digests(stage()) == expected
    assert again.items <= whole.items - done + 3  # the item that ends a loop early is done again after each kill
    assert again.said


class BlockMatcher(ToyMatcher):
    """Draws candidates as the toy does, and adds to their offsets block by block."""

    type: ClassVar[str] = "in-blocks"
    begun: ClassVar[list[int]] = []
    killed_at: ClassVar[int] = -1

    def match(self, scene: Scene, rng: np.random.Generator, progress: Progress = silent) -> Candidates:
        found = super().match(scene, rng, progress)
        offsets = found.offsets_mm.copy()
        for k in resumable(range(6), offsets):
            self.begun.append(k)
            if k == self.killed_at:
                raise Terminated
            offsets += np.float32(0.01 * k)
        return Candidates(offsets, found.maps, found.errors, found.metrics)


class Noting(Observer):
    def __init__(self) -> None:
        self.notices: list[str] = []

    def notice(self, text: str) -> None:
        self.notices.append(text)


@pytest.mark.usefixtures("eager")
def test_a_killed_run_goes_on_at_the_block_of_the_stage_that_it_was_in(
    write_spec: SpecWriter, cache: Cache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magiclens.scenarios.pictures.TARGET_ART_PX", 32)
    monkeypatch.setattr(BlockMatcher, "begun", [])
    plan = load_plan(write_spec(), ["pipeline.matcher={type: in-blocks}"], registry_of(*TOYS, BlockMatcher))

    def files(name: str) -> dict[str, bytes]:
        folder = tmp_path / name
        return {path.name: path.read_bytes() for path in folder.rglob("*.*") if path.suffix in (".png", ".toy")}

    run_plan(plan, tmp_path / "plain")
    assert BlockMatcher.begun == [0, 1, 2, 3, 4, 5]
    monkeypatch.setattr(BlockMatcher, "killed_at", 4)
    with pytest.raises(Terminated):
        run_plan(plan, tmp_path / "killed", None, cache)
    assert not (tmp_path / "killed").exists()
    monkeypatch.setattr(BlockMatcher, "killed_at", -1)
    BlockMatcher.begun.clear()
    noting = Noting()
    run_plan(plan, tmp_path / "again", noting, cache)
    assert BlockMatcher.begun == [4, 5]
    assert "matcher in-blocks goes on where a run was ended: 4 of 6 parts are kept" in noting.notices
    assert files("again") == files("plain")
    assert "lens.toy" in files("again")
    assert not [step for step in entries(cache) if "unfinished" in step]
