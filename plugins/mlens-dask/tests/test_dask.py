"""A real scheduler and real worker processes: the same bytes as serial, and no loss when a worker is killed."""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import dask
import numpy as np
import psutil
import pytest
from distributed import Client, LocalCluster
from mlens_dask.executor import Dask
from mlens_dask.matcher import Blocks
from typer.testing import CliRunner

from magiclens import Candidates, Exhaustive, InputError, Scene, StageError, load_plan, raising, run_spec
from magiclens.cli import app
from magiclens.testing import ExecutorContract

SPEC = """\
scenario: {type: single, source: {type: circles, seed: 7, size: 12mm}, target: {art: heart}}
lens: {size: 12mm, facets: 4, microfacets: 4, thickness: 15mm, relief: 4mm}
pipeline:
  matcher: {type: exhaustive, window: 10%, scales: [0.3, 0.8], candidates: 9}
  renderers: [{type: tracer, resolution: 64, samples: 2}]
report: {analyses: []}
"""
SWEEP = ["--set", "lens.facets=2,3,4"]

_Seen = TypeVar("_Seen")


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spec") / "tiny.yaml"
    path.write_text(SPEC, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The address of a scheduler with one worker, which another program has started."""
    with LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address="127.0.0.1:0") as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def idle(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalCluster]:
    """A scheduler without workers, which the user is told of at once."""
    monkeypatch.setattr("mlens_dask.cluster.PATIENCE_S", 0.1)
    with LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        yield cluster


@pytest.fixture(scope="module")
def serial(spec: Path) -> dict[str, bytes]:
    """What a sweep without a cluster writes."""
    return swept(spec, spec.parent / "serial")


@pytest.fixture(scope="module")
def scene(spec: Path) -> Scene:
    return load_plan(spec, ["lens.facets=5"]).scene()


def swept(spec: Path, out: Path, *options: str) -> dict[str, bytes]:
    result = CliRunner().invoke(app, ["sweep", str(spec), *SWEEP, "--out", str(out), "--quiet", *options])
    assert result.exit_code == 0, result.output
    return contents(out)


def contents(out: Path) -> dict[str, bytes]:
    """Every file of every run folder; timings left out of the manifests."""
    found = {path.relative_to(out).as_posix(): path.read_bytes() for path in out.glob("*/**/*") if path.is_file()}
    manifests = {name: untimed(text) for name, text in found.items() if name.endswith("manifest.json")}
    return {**found, **manifests}


def untimed(manifest: bytes) -> bytes:
    data = json.loads(manifest)
    stages = [{**stage, "seconds": 0} for stage in data["stages"]]
    return json.dumps({**data, "stages": stages, "seconds": 0}).encode()


def square(number: int) -> int:
    if number == 3:
        raise InputError("three is not allowed")
    return number * number


def killing_once(flag: Path, number: int) -> int:
    """Kills its own process the first time that it is given 1."""
    if number == 1 and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def deadly(number: int) -> int:
    if number == 1:
        time.sleep(1)  # a worker that dies while it starts is not started again by its nanny
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def overlapping(lock: Path, number: int) -> int:
    """Fails if another item is worked on meanwhile."""
    lock.touch(exist_ok=False)
    time.sleep(0.1)
    lock.unlink()
    return number


def slow(number: int) -> int:
    time.sleep(0.5)
    return number


class Programs:
    """A scheduler and workers as programs, as on machines of one's own: who starts workers starts them again."""

    def __init__(self, workers: int):
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        # the functions of this file are found there, too
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        self.environment = {**os.environ, "NUMBA_NUM_THREADS": "1", "PYTHONPATH": path}
        self.scheduler = self.started_scheduler()
        worker = f"{sys.executable} -m distributed.cli.dask_worker {self.address} --nthreads 1 --host 127.0.0.1"
        forever = ["sh", "-c", f"while sleep 0.1; do {worker}; done"]
        self.workers = [
            subprocess.Popen(forever, start_new_session=True, stderr=subprocess.DEVNULL, env=self.environment)
            for _ in range(workers)
        ]

    def started_scheduler(self) -> subprocess.Popen[bytes]:
        where = ["--host", "127.0.0.1", "--port", str(self.port), "--dashboard-address", "127.0.0.1:0"]
        command = [sys.executable, "-m", "distributed.cli.dask_scheduler", *where]
        return subprocess.Popen(command, stderr=subprocess.DEVNULL, env=self.environment)

    def wait_for_work(self) -> None:
        """Return when some worker has something to do."""
        with Client(self.address, set_as_default=False) as client:
            waited_for(lambda: any(client.processing().values()) or None)

    def kill_scheduler(self) -> None:
        """Kill it, and start another one at the same address."""
        self.scheduler.kill()
        self.scheduler.wait()
        self.scheduler = self.started_scheduler()

    def kill_a_worker(self, then: Callable[[], None] = lambda: None) -> None:
        """Kill a worker that is at work, not who starts it again; return when the scheduler knows.

        Args:
            then: Done before another worker can do what this one leaves.
        """
        with Client(self.address, set_as_default=False) as client:

            def at_work() -> str | None:
                return next((at for at, keys in client.processing().items() if keys), None)

            def suspended_at_work() -> str | None:
                """A worker with an item that it cannot end; all are suspended then."""
                waited_for(at_work)
                for process in processes.values():
                    process.suspend()
                time.sleep(0.1)  # what was on its way to the scheduler is there
                if (address := at_work()) is None:
                    for process in processes.values():
                        process.resume()
                return address

            waited_for(at_work)
            processes = {at: psutil.Process(pid) for at, pid in client.run(os.getpid).items()}
            address = waited_for(suspended_at_work)
            worker = processes.pop(address)
            for process in (worker.parent(), worker):  # its nanny would start it again, too
                process.kill()
            waited_for(lambda: address not in client.processing())
        then()
        for other in processes.values():
            other.resume()

    def kill_both(self) -> None:
        """Kill a worker that is at work, and the scheduler before others have done what it leaves."""
        self.kill_a_worker(self.kill_scheduler)

    def end(self) -> None:
        for session in self.workers:
            os.killpg(session.pid, signal.SIGKILL)
            session.wait()
        self.scheduler.kill()
        self.scheduler.wait()


@pytest.fixture(scope="module")
def programs() -> Iterator[Programs]:
    started = Programs(workers=2)
    yield started
    started.end()


def scaled(given: tuple[Any, Path], block: Any) -> Any:
    """A multiple of a block of numbers; from the third block on, not before a file is there."""
    factor, gate = given
    while block[0] > 1 and not gate.exists():
        time.sleep(0.01)
    return factor[0] * block


def waited_for(what: Callable[[], _Seen | None]) -> _Seen:
    """What a function returns as soon as that is something."""
    limit = time.monotonic() + 120
    while time.monotonic() < limit:
        if found := what():
            return found
        time.sleep(0.01)
    raise TimeoutError


def environment(_: int) -> str | None:
    return os.environ.get("NUMBA_NUM_THREADS")


class TestDask(ExecutorContract):
    """The contract of all executors."""

    @pytest.fixture(autouse=True)
    def _running(self, scheduler: str) -> None:
        self.executor = Dask(address=scheduler)


def test_results_come_in_order_and_a_failure_stops_no_other(scheduler: str) -> None:
    results = list(Dask(address=scheduler).map(square, range(6)))
    assert [results[k] for k in (0, 1, 2, 4, 5)] == [0, 1, 4, 16, 25]
    assert isinstance(results[3], InputError)


def test_equal_items_are_each_worked_on(scheduler: str) -> None:
    assert list(Dask(address=scheduler).map(square, [2, 2, 2])) == [4, 4, 4]


def test_a_worker_with_several_threads_works_on_one_item_at_a_time(scheduler: str, tmp_path: Path) -> None:
    results = raising(Dask(address=scheduler).map(partial(overlapping, tmp_path / "lock"), range(6)))
    assert list(results) == [0, 1, 2, 3, 4, 5]


def test_what_a_killed_worker_had_is_done_by_others(tmp_path: Path) -> None:
    results = list(Dask(workers=2).map(partial(killing_once, tmp_path / "flag"), range(6)))
    assert (tmp_path / "flag").exists()
    assert results == [0, 1, 2, 3, 4, 5]


def test_an_item_that_kills_every_worker_is_given_up_and_stops_no_other() -> None:
    # Dask closes lost workers: so soon after a loss, that would hit each one that is just being started again. It gives
    # an item up after the first death here, and not after the fourth
    with dask.config.set(
        {"distributed.deploy.lost-worker-timeout": "0.3s", "distributed.scheduler.allowed-failures": 0}
    ):
        results = list(Dask(workers=1, wait_s=60).map(deadly, range(3)))
    assert (results[0], results[2]) == (0, 2)
    assert isinstance(results[1], StageError)
    assert "worker after worker died of this" in str(results[1])


@pytest.mark.parametrize("victim", ["scheduler", "worker", "both"])
def test_arrays_are_found_again_when_the_scheduler_or_a_worker_is_killed(
    programs: Programs, victim: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, blocks = (np.full(100_000, 3.0), tmp_path / "gate"), [np.full(1000, float(k)) for k in range(6)]
    kill = {"scheduler": programs.kill_scheduler, "worker": programs.kill_a_worker, "both": programs.kill_both}[victim]

    def kill_at_work() -> None:
        programs.wait_for_work()
        kill()
        (tmp_path / "gate").touch()

    with Dask(address=programs.address, wait_s=120).spreader() as cluster, ThreadPoolExecutor(1) as killer:
        before = list(cluster.map(scaled, given, blocks[:2]))  # what all items share is on a worker now
        killed = killer.submit(kill_at_work)
        found = list(cluster.map(scaled, given, blocks))
        after = list(cluster.map(scaled, given, blocks[:2]))
    assert killed.exception() is None
    said = "does not answer; what was under way begins again" in capsys.readouterr().err
    assert said == (victim != "worker")
    assert [block.tobytes() for block in found] == [(3 * block).tobytes() for block in blocks]
    assert [block.tobytes() for block in (*before, *after)] == [(3 * block).tobytes() for block in blocks[:2]] * 2


def test_the_scheduler_passes_on_no_arrays(idle: LocalCluster, tmp_path: Path) -> None:
    idle.scale(2)
    asked: list[str] = []
    for name in ("scatter", "gather"):  # by which others send and get data through a scheduler
        idle.scheduler.handlers[name] = lambda name=name, **_: asked.append(name)
    with Dask(address=idle.scheduler_address).spreader() as cluster:
        found = list(cluster.map(scaled, (np.full(1000, 2.0), tmp_path), [np.ones(1000), np.ones(1000)]))
    assert [block.tobytes() for block in found] == [np.full(1000, 2.0).tobytes()] * 2
    assert asked == []


def test_what_was_sent_to_a_worker_that_the_scheduler_does_not_know_is_sent_again(
    idle: LocalCluster, tmp_path: Path
) -> None:
    idle.scale(1)
    known, deaths = (
        idle.scheduler.handlers["update_data"],
        [KeyError("tcp://127.0.0.1:1"), ValueError("none to copy to")],
    )

    def forgetful(**what: Any) -> Any:
        if deaths:
            raise deaths.pop()
        return known(**what)

    idle.scheduler.handlers["update_data"] = forgetful
    with Dask(address=idle.scheduler_address).spreader() as cluster:
        found = list(cluster.map(scaled, (np.full(10, 2.0), tmp_path), [np.ones(10)]))
    assert found[0].tolist() == [2.0] * 10
    assert deaths == []


def test_workers_of_our_own_have_the_threads_asked_for() -> None:
    assert list(Dask(workers=1, threads=3).map(environment, range(1))) == ["3"]


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mlens_dask.cluster.TIMEOUT_S", 0.5)
    with pytest.raises(InputError, match=r"address: no scheduler answers at 'tcp://127.0.0.1:1'"):
        list(Dask(address="tcp://127.0.0.1:1").map(square, range(2)))


def test_a_sweep_without_workers_says_how_to_start_one_and_ends_with_2(
    spec: Path, idle: LocalCluster, tmp_path: Path
) -> None:
    options = ["--executor", "dask", "--executor-set", f"address={idle.scheduler_address}"]
    out = ["--out", str(tmp_path / "out"), "--executor-set", "wait_s=0.5"]
    done = CliRunner().invoke(app, ["sweep", str(spec), *SWEEP, *options, *out])
    assert done.exit_code == 2
    advice = f"start one on any machine: dask worker {idle.scheduler_address} --nthreads 1"
    assert f"note: {idle.scheduler_address} has no worker; {advice}\n" in done.stderr
    error = f"error: wait_s: no worker of {idle.scheduler_address} for 0.5 seconds; {advice}"
    assert done.stderr.splitlines()[-1] == error
    assert not (tmp_path / "out").exists()


class Listener(io.StringIO):
    """The screen of a user who starts a worker when there is none."""

    def __init__(self, cluster: LocalCluster):
        super().__init__()
        self.cluster = cluster

    def write(self, text: str) -> int:
        if "has no worker" in text:
            self.cluster.scale(1)
        return super().write(text)


def test_a_worker_that_comes_late_does_the_work(idle: LocalCluster) -> None:
    with redirect_stderr(Listener(idle)) as screen:
        assert list(Dask(address=idle.scheduler_address).map(square, range(3))) == [0, 1, 4]
    assert screen.getvalue().count("has no worker") == 1


def test_a_list_whose_last_worker_has_gone_does_not_wait_for_ever(idle: LocalCluster) -> None:
    idle.scale(1)
    idle.wait_for_workers(1)
    results = iter(Dask(address=idle.scheduler_address, wait_s=1).map(slow, range(20)))
    assert next(results) == 0
    idle.scale(0)
    with pytest.raises(InputError, match=r"no worker of .* for 1 seconds"):
        list(results)


def test_a_sweep_on_a_scheduler_that_is_running_writes_the_same_bytes(
    spec: Path, serial: dict[str, bytes], scheduler: str, tmp_path: Path
) -> None:
    found = swept(spec, tmp_path / "out", "--executor", "dask", "--executor-set", f"address={scheduler}")
    assert len([name for name in serial if name.endswith("manifest.json")]) == 3
    assert found == serial


def test_a_worker_that_is_killed_in_mid_sweep_loses_nothing(
    spec: Path, serial: dict[str, bytes], tmp_path: Path
) -> None:
    out, killed = tmp_path / "out", list[int]()
    killer = threading.Thread(target=kill_one, args=(out, killed))
    killer.start()
    found = swept(spec, out, "--executor", "dask", "--executor-set", "workers=2")
    killer.join()
    assert killed
    assert not psutil.pid_exists(killed[0])
    assert found == serial
    assert sorted(path.name for path in out.iterdir() if path.name.startswith(".")) == []


def kill_one(out: Path, killed: list[int]) -> None:
    """Kill the worker that is in the middle of a run, as soon as another run is finished."""
    limit = time.monotonic() + 120
    while time.monotonic() < limit and not killed:
        half_done = list(out.glob(".mlens-*/*/spec.yaml"))
        if half_done and list(out.glob("*/manifest.json")):
            worker = int(half_done[0].parents[1].name.split("-")[3])  # the process that works in this folder
            os.kill(worker, signal.SIGKILL)
            killed.append(worker)
        time.sleep(0.01)


@pytest.mark.parametrize("blocks", [None, 2, 99])
def test_blocks_of_facets_are_matched_byte_by_byte_as_all_at_once(
    scene: Scene, scheduler: str, blocks: int | None
) -> None:
    options: dict[str, Any] = {"scales": (0.3, 0.8), "candidates": 9}
    matcher = Blocks(cluster=Dask(address=scheduler), blocks=blocks, **options)
    done: list[float] = []
    found = matcher.match(scene, np.random.default_rng(0), done.append)
    assert same(found, Exhaustive(**options).match(scene, np.random.default_rng(0)))
    assert done[-1] == 1


def same(one: Candidates, other: Candidates) -> bool:
    names = ("offsets_mm", "maps", "errors")
    both = [(getattr(one, name), getattr(other, name)) for name in names]
    return all(a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in both)


def test_a_facet_without_a_patch_is_named_by_its_place_in_the_lens(scene: Scene, scheduler: str) -> None:
    options: dict[str, Any] = {"scales": (60.0,), "candidates": 4}
    rng = np.random.default_rng(0)
    with pytest.raises(InputError) as alone:
        Exhaustive(**options).match(scene, rng)
    with pytest.raises(InputError) as spread:
        Blocks(cluster=Dask(address=scheduler), **options).match(scene, rng)
    assert str(spread.value) == str(alone.value)


def test_a_lens_matched_in_blocks_is_the_same_lens(spec: Path, scheduler: str, tmp_path: Path) -> None:
    chosen = f"{{type: dask, window: 10%, scales: [0.3, 0.8], candidates: 9, cluster: {{address: '{scheduler}'}}}}"
    spread = run_spec(spec, tmp_path / "spread", [f"pipeline.matcher={chosen}", "lens.facets=3"])
    alone = run_spec(spec, tmp_path / "alone", ["lens.facets=3"])
    for name in ("lens.stl", "renders/tracer/single.png", "heights.npz"):
        assert (spread.folder / name).read_bytes() == (alone.folder / name).read_bytes()


def test_a_lens_is_the_same_when_a_worker_and_the_scheduler_are_killed_in_mid_run(
    spec: Path, programs: Programs, tmp_path: Path
) -> None:
    matcher = "pipeline.matcher={type: exhaustive, window: 40%, scales: [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8]}"
    command = ["run", str(spec), "--set", matcher, "--set", "lens.facets=40", "--quiet", "--out"]
    assert CliRunner().invoke(app, [*command, str(tmp_path / "a" / "alone")]).exit_code == 0
    spreading = ["--executor", "dask", "--executor-set", f"address={programs.address}"]
    with ThreadPoolExecutor(1) as killer:
        killed = killer.submit(programs.kill_both)
        done = CliRunner().invoke(app, [*command, str(tmp_path / "b" / "alone"), *spreading])
    assert done.exit_code == 0, done.output
    assert killed.exception() is None
    assert "does not answer; what was under way begins again" in done.stderr
    assert contents(tmp_path / "b") == contents(tmp_path / "a")


def test_on_a_worker_a_block_matcher_needs_no_cluster_of_its_own(spec: Path, scheduler: str, tmp_path: Path) -> None:
    command = ["sweep", str(spec), "--set", "pipeline.matcher.type=dask", "--set", "lens.facets=3", "--quiet"]
    more = ["--executor", "dask", "--executor-set", f"address={scheduler}", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*command, *more])
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("pipeline.matcher={type: dask, cluster: {wokers: 2}}", "wokers: unknown option; did you mean 'workers'?"),
        ("pipeline.matcher={type: dask, blocks: 0}", "blocks: must be at least 1, got 0"),
    ],
)
def test_wrong_options_are_named(spec: Path, setting: str, message: str) -> None:
    result = CliRunner().invoke(app, ["check", str(spec), "--set", setting])
    assert result.exit_code == 2
    assert message in result.stderr
