"""Fixtures that several test modules use."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from playwright.sync_api import Browser

from browsers import chromium
from lenses import CACHE_BYTES, RECIPES, Lenses
from magiclens.cache.store import Cache
from magiclens.cli.doctor import examine
from magiclens.kernels.cache_folder import cache_folder
from magiclens.plan.registry import Registry
from magiclens.running.compilation import compile_all_kernels
from toys import SPEC, TOYS, SpecWriter, registry_of

os.environ.setdefault("OMP_WAIT_POLICY", "passive")
"""Tests run side by side: kernels whose threads wait busily for each other would take the others' cores."""

hypothesis.settings.register_profile("suite", deadline=None)
hypothesis.settings.load_profile("suite")
"""Machines of the suite are busy and compile on the way: how long an example takes says nothing."""

os.environ["MLENS_CACHE_SIZE"] = "0"
"""Tests see every stage run, and leave the user's cache alone; those about the cache have one of their own."""


def pytest_configure() -> None:
    # a shell's background jobs ignore Ctrl-C, and so would all that tests start
    signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.set_threshold(100_000)  # as the command line does


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile all kernels in two processes, or each worker would compile them; not for tests that are named."""
    config = session.config
    named = config.invocation_params.args and any(Path(word).exists() for word in config.invocation_params.args)
    if not named and config.getoption("numprocesses", None):
        compile_once()


def compile_once() -> None:
    done = cache_folder() / "all"
    if not done.exists():
        compile_all_kernels()
        done.touch()


@pytest.fixture(scope="session")
def compiled() -> None:
    """For tests that measure time: kernels are compiled, also where the tests are named."""
    compile_once()


LONGEST = ("test_viewer", "test_docs", "test_studio_lens", "test_gallery")
"""Files that take longest in the tools tier. They begin first, or one process works on the last of them alone."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whatever asks a browser belongs to the tools tier, unless it is a sweep; so do most of very many variants."""
    items.sort(key=lambda item: LONGEST.index(item.path.stem) if item.path.stem in LONGEST else len(LONGEST))
    variants = Counter[str]()
    for item in items:
        if item.get_closest_marker("every_third"):
            name = item.nodeid.partition("[")[0]
            if variants[name] % 3:
                item.add_marker("tools")
            variants[name] += 1
        if "browser" in getattr(item, "fixturenames", ()) and not item.get_closest_marker("sweep"):
            item.add_marker("tools")
        if item.get_closest_marker("sweep") and item.get_closest_marker("tools"):
            raise pytest.UsageError(f"{item.nodeid} is in two tiers: 'pytest -m tools' would run a sweep")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """One line on what plain ``pytest`` leaves out."""
    if "not tools" not in config.getoption("markexpr"):
        return
    missing = [finding.name for finding in examine(Registry.load()) if finding.status != "ok" and not finding.needed]
    lack = f"this machine lacks {', '.join(missing)}: see 'mlens doctor'" if missing else "this machine has them all"
    terminalreporter.write_line(
        f"Left out: 'pytest -m tools' asks other programs ({lack}); 'pytest -m sweep' runs every spec at full size."
    )


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A real one."""
    with chromium() as opened:
        yield opened


@pytest.fixture(scope="session")
def lenses(tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config) -> Lenses:
    """Small lenses, each designed once for all processes of the session; ``--cache-clear`` forgets earlier sessions."""
    own = tmp_path_factory.getbasetemp()
    cache = getattr(pytestconfig, "cache", None)  # there is none with "-p no:cacheprovider"
    kept = Cache(cache.mkdir(f"lenses-{RECIPES}"), CACHE_BYTES) if cache else None
    return Lenses((own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "lenses", kept)


@pytest.fixture
def registry() -> Registry:
    """Built-in scenarios and art, and the toy stages."""
    return registry_of(*TOYS)


@pytest.fixture
def write_spec(tmp_path: Path) -> SpecWriter:
    """Writes the spec above, with replacements made in its text, and returns its path."""

    def write(*replacements: tuple[str, str], text: str = SPEC) -> Path:
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "toy.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def grey_png(tmp_path: Path) -> Path:
    """A small picture file beside the spec, wider than high."""
    from magiclens.images.files import write_png

    path = tmp_path / "grey.png"
    write_png(path, np.full((40, 60, 1), 0.2, np.float32))
    return path
