"""Executors: the order of results, failures that stop no other item, processes that die, and choosing an executor."""

from __future__ import annotations

import os
import signal
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from magiclens import builtin
from magiclens.contract.errors import InputError, StageError
from magiclens.contract.executors import Executor, Processes, Serial, cores, raising, threads_each
from magiclens.contract.hookspecs import hookimpl
from magiclens.plan.registry import EXECUTOR, Plugin, Registry
from magiclens.running.jobs import choose_executor
from magiclens.testing import ExecutorContract


def picky(number: int) -> int:
    if number == 1:
        raise InputError("one is not allowed", "here")
    return number


def deadly(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def here(_: int) -> tuple[int, str | None]:
    time.sleep(0.2)
    return os.getpid(), os.environ.get("NUMBA_NUM_THREADS")


@pytest.fixture(params=[Serial(), Processes(workers=2)], ids=["serial", "processes"])
def executor(request: pytest.FixtureRequest) -> Executor:
    found: Executor = request.param
    return found


@pytest.fixture
def executors() -> Registry:
    """A registry of the built-in executors."""
    registry = Registry()
    registry.register(SimpleNamespace(mlens_executors=builtin.mlens_executors), Plugin("builtin", "magiclens", "1"))
    assert registry.failures == []
    return registry


class TestSerial(ExecutorContract):
    executor = Serial()


class TestProcesses(ExecutorContract):
    executor = Processes(workers=2)


def test_the_first_error_is_raised_where_all_results_are_needed(executor: Executor) -> None:
    results = raising(executor.map(picky, range(3)))
    assert next(results) == 0
    with pytest.raises(InputError, match="one is not allowed"):
        next(results)


def test_serial_begins_nothing_before_it_is_asked_for() -> None:
    begun: list[int] = []
    results = Serial().map(begun.append, range(3))
    next(results)
    assert begun == [0]


def test_a_process_that_dies_takes_only_its_item_with_it() -> None:
    results = list(Processes(workers=2).map(deadly, range(4)))
    assert [results[k] for k in (0, 2, 3)] == [0, 2, 3]
    assert isinstance(results[1], StageError)
    assert "died" in str(results[1])


def test_processes_work_side_by_side_and_share_the_cores() -> None:
    workers = set(raising(Processes(workers=2).map(here, range(4))))
    assert len({process for process, _ in workers}) == 2
    assert os.getpid() not in {process for process, _ in workers}
    assert {threads for _, threads in workers} == {str(threads_each(2))}


def test_threads_are_shared_out_and_each_process_has_one_at_least() -> None:
    assert threads_each(1) == cores()
    assert threads_each(10_000) == 1


def test_no_process_is_left_when_the_iterator_is_closed(tmp_path: Path) -> None:
    results = Processes(workers=1).map(partial(noted, tmp_path), range(50))
    pid = next(results)
    results.close()  # type: ignore[attr-defined]
    assert len(list(tmp_path.iterdir())) < 50
    with pytest.raises(ProcessLookupError):
        os.kill(int(str(pid)), 0)


def noted(folder: Path, number: int) -> int:
    (folder / str(number)).touch()
    time.sleep(0.02)
    return os.getpid()


def test_executors_are_chosen_by_name_with_options(executors: Registry) -> None:
    assert choose_executor("processes", ["workers=3"], executors) == Processes(workers=3)
    assert choose_executor("serial", [], executors) == Serial()


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("serail", [], "--executor: unknown executor 'serail'; did you mean 'serial'?"),
        ("processes", ["wokers=2"], "--executor processes: wokers: unknown option; did you mean 'workers'?"),
        ("processes", ["workers=0"], "--executor processes: workers: must be at least 1, got 0"),
        ("processes", ["workers=few"], "--executor processes: workers: expected a whole number, got 'few'"),
        ("processes", ["workers"], "--executor-set workers: write key=value, such as workers=2"),
        ("processes", ["workers=[1"], "--executor-set workers=[1: '[1' is not a value that YAML can read"),
    ],
)
def test_wrong_choices_are_named(executors: Registry, name: str, settings: list[str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        choose_executor(name, settings, executors)
    assert str(caught.value) == message


class Lazy(Executor):
    type = "lazy"



@pytest.mark.parametrize(("contributed", "flaw"), [(Lazy, "lacks map"), (object, "type is not text")])
def test_what_is_no_executor_is_recorded_and_left_out(executors: Registry, contributed: type, flaw: str) -> None:
    plugin = SimpleNamespace(mlens_executors=hookimpl(lambda: [contributed], specname="mlens_executors"))
    executors.register(plugin, Plugin("odd", "odd-package", "0.1"))
    assert executors.types(EXECUTOR) == ["processes", "serial"]
    assert flaw in executors.failures[0].reason
