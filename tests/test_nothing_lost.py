"""Whatever fails, and whenever a run is killed: the older run or the new one is there, whole, and nothing else."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

import magiclens.running.compilation  # noqa: F401
from faults import Ended, command, signalled
from magiclens.contract.artifacts import Scene, Solid
from magiclens.contract.stages import KINDS
from magiclens.plan.compile import load_plan
from magiclens.running.pipeline import run_plan
from magiclens.running.replacing import clear_leftovers
from toys import SPEC, TOYS, ToyExporter, no_timings, registry_of

CODES = {signal.SIGKILL: -signal.SIGKILL, signal.SIGTERM: 143, signal.SIGINT: 130}
"""Exit codes by signal."""
OLD, NEW = 1, 2
"""Seeds of the older run and of the one that replaces it."""


class Mute(ToyExporter):
    """Does not say which file it could not write, as many libraries."""

    def export(self, scene: Scene, solid: Solid, path: Path) -> None:
        try:
            super().export(scene, solid, path)
        except OSError as error:
            raise OSError(error.errno, error.strerror) from None


class Place:
    """A folder with two specs, whose runs are written to ``out`` in it."""

    def __init__(self, folder: Path):
        self.root, self.out = folder / "root", folder / "root" / "out"
        self._registry = registry_of(*(toy for toy in TOYS if toy is not ToyExporter), Mute)
        self.root.mkdir()
        for seed in (OLD, NEW):
            (self.root / f"{seed}.yaml").write_text(f"name: lens\nseed: {seed}\n{SPEC}", encoding="utf-8")
        # in this process, so that what it imports is there in all that are forked
        run_plan(load_plan(self.root / f"{OLD}.yaml", (), self._registry), self.out)
        self._older = shutil.copytree(self.out, folder / "older")
        self.old = self.found()
        assert self.run().code == 0
        self.new = self.found()
        assert self.old != self.new

    def run(self, seed: int = NEW, **faults: object) -> Ended:
        arguments = ["run", str(self.root / f"{seed}.yaml"), "--out", str(self.out), "--quiet"]
        return command(arguments, self._registry, self.root, **faults)  # type: ignore[arg-type]

    def begin(self, older: bool) -> None:
        """Put the older run in place, or nothing."""
        shutil.rmtree(self.out, ignore_errors=True)
        if older:
            shutil.copytree(self._older, self.out)

    def changes(self, older: bool, swaps: bool) -> int:
        """How many changes a run makes."""
        self.begin(older)
        return self.run(swaps=swaps).changes

    def found(self) -> dict[str, bytes]:
        """The files of the run; timings left out."""
        paths = [path for path in self.out.rglob("*") if path.is_file()]
        files = {path.relative_to(self.out).as_posix(): path.read_bytes() for path in paths}
        if "manifest.json" in files:
            files["manifest.json"] = json.dumps(no_timings(json.loads(files["manifest.json"]))).encode()
        return files

    def strays(self) -> set[str]:
        return set(os.listdir(self.root)) - {f"{OLD}.yaml", f"{NEW}.yaml", "out", "cache"}

    def check(self, older: bool, ended: Ended) -> None:
        """What must hold after any fault."""
        assert "Traceback" not in ended.errors
        if ended.code < 0:
            clear_leftovers(self.out)  # as the next run begins: killed between two renames, the older run is hidden
        found = self.found()
        assert found == self.new or found == (self.old if older else {})
        # the last change of a run removes the hidden folder, which the next run does if this one could not
        assert found == self.new or self.strays() == set()

    def check_next_run(self) -> Ended:
        """What must hold after the run that follows."""
        ended = self.run()
        assert (ended.code, self.found() == self.new, self.strays()) == (0, True, set()), ended
        return ended


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("magiclens.scenarios.pictures.TARGET_ART_PX", 32)
        return Place(tmp_path_factory.mktemp("place"))


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Targets are drawn coarsely: nobody looks at them."""
    monkeypatch.setattr("magiclens.scenarios.pictures.TARGET_ART_PX", 32)


@pytest.fixture(params=[True, False], ids=["swapping", "renaming"])
def swaps(request: pytest.FixtureRequest) -> bool:
    """Whether the system can exchange two names at one moment."""
    found: bool = request.param
    return found


def some(most: int, step: int, last: int = 6) -> list[int]:
    """Numbers of changes: some of all, and each of the last, among which the run takes its place."""
    return sorted({*range(1, most, step), *range(most - last, most + 1)})


def failing(place: Place, numbers: list[int], older: bool, swaps: bool) -> None:
    """Let each of these changes fail."""
    for number in numbers:
        place.begin(older)
        ended = place.run(at=number, swaps=swaps)
        place.check(older, ended)
        # what cannot be removed fails silently: nothing is wrong with the run
        if ended.code != 0:
            assert ended.code in (1, 2)
            assert ended.errors.endswith("No space left on device\n") or "lens.toy" in ended.errors
            assert any(name in ended.errors for name in (str(place.out), str(place.root), "lens.toy"))
            assert ended.errors.count("\n") == 1
    place.check_next_run()


def test_a_change_that_fails_is_named_and_loses_nothing(place: Place) -> None:
    """Where names cannot be exchanged, which is the harder case."""
    failing(place, some(place.changes(True, False), 16, 4), True, False)


@pytest.mark.sweep
@pytest.mark.parametrize("older", [True, False])
def test_every_change_that_fails_loses_nothing(older: bool, place: Place, swaps: bool) -> None:
    failing(place, some(place.changes(older, swaps), 1), older, swaps)


def ended_by(place: Place, number: signal.Signals, at: int, older: bool, swaps: bool) -> tuple[Ended, Ended]:
    """Let a signal come at a change, and then run again: both runs."""
    place.begin(older)
    ended = place.run(at=at, fault=signalled(number), swaps=swaps)
    assert ended.code == CODES[number], ended
    place.check(older, ended)
    return ended, place.check_next_run()


@pytest.mark.parametrize(
    "number",
    [pytest.param(each, marks=[pytest.mark.tools] * (each != signal.SIGKILL)) for each in CODES],
    ids=lambda number: number.name,
)
def test_a_signal_at_any_change_loses_nothing(number: signal.Signals, place: Place) -> None:
    for at in some(place.changes(True, False), 70, 3):
        ended_by(place, number, at, True, False)


@pytest.mark.sweep
@pytest.mark.parametrize("older", [True, False])
@pytest.mark.parametrize("number", CODES, ids=lambda number: number.name)
def test_signals_at_every_change_lose_nothing(
    number: signal.Signals, older: bool, place: Place, swaps: bool
) -> None:
    kills = number == signal.SIGKILL
    places = some(place.changes(older, swaps), 1 if kills else 5)
    assert len(places) >= (50 if kills else 13)  # so 200 and 52 of all these tests
    for at in places:
        ended_by(place, number, at, older, swaps)


@pytest.mark.parametrize("step", [pytest.param(40, marks=pytest.mark.tools), pytest.param(2, marks=pytest.mark.sweep)])
def test_a_run_that_is_killed_while_it_keeps_results_spoils_none(
    step: int, place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLENS_CACHE_SIZE", "1GB")
    monkeypatch.setenv("MLENS_CACHE_DIR", str(place.root / "cache"))
    for at in some(place.changes(True, True), step, 0):
        shutil.rmtree(place.root / "cache")
        killed, again = ended_by(place, signal.SIGKILL, at, True, True)
        stages = [name for name in killed.parts if name.split()[0] in KINDS]
        assert [name for name in again.parts if name in stages] in ([], stages[-1:])  # that in which it was killed


@pytest.mark.parametrize("largest_bytes", [0, 300, 3_000, 9_000])
def test_files_that_may_not_grow_lose_nothing(largest_bytes: int, place: Place) -> None:
    place.begin(True)
    ended = place.run(largest_bytes=largest_bytes)
    assert ended.code == 1
    assert "File too large" in ended.errors
    assert str(place.out) in ended.errors or "lens.toy" in ended.errors
    assert place.found() == place.old
    assert place.strays() == set()


@pytest.mark.tools
@pytest.mark.skipif(os.getuid() != 0, reason="only root may mount a disk")
def test_a_disk_that_is_full_loses_nothing(place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Real disks of more and more room, until a run fits."""
    disk = tmp_path / "disk"
    disk.mkdir()
    monkeypatch.setattr(place, "out", disk / "out")
    for pages in range(2, 1000, 4):
        mount = ["mount", "-t", "tmpfs", "-o", f"size={4 * pages}k", "small", str(disk)]
        subprocess.run(mount, check=True)
        try:
            ended = place.run()
            left = os.listdir(disk)
            whole = place.found()
        finally:
            subprocess.run(["umount", str(disk)], check=True)
        if ended.code == 0:
            assert (left, whole) == (["out"], place.new)
            assert pages > 10
            return
        assert ended.code in (1, 2)
        assert "No space left on device" in ended.errors
        assert str(disk) in ended.errors or "lens.toy" in ended.errors
        assert left == []
    raise AssertionError("no disk was large enough")
