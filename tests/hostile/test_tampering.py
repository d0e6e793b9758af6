"""Run folders that were tampered with at random: refused in one line with exit code 2, or read; never a traceback."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_mutated_specs import TREE, places
from test_run_folders import READ, commands, forge, refused, whole  # noqa: F401  # a fixture among them
from typer.testing import CliRunner

from magiclens.cli import app


def flipped(content: bytes, rng: random.Random) -> bytes:
    spoilt = bytearray(content)
    for _ in range(rng.choice([1, 1, 5, 100])):
        spoilt[rng.randrange(len(spoilt))] ^= 1 << rng.randrange(8)
    return bytes(spoilt)


def cut(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randrange(len(content))]


def without_a_part(content: bytes, rng: random.Random) -> bytes:
    first = rng.randrange(len(content))
    return content[:first] + content[first + rng.choice([1, 10, 1000]) :]


def repeated(content: bytes, rng: random.Random) -> bytes:
    return content * rng.choice([2, 3])


def noise(content: bytes, rng: random.Random) -> bytes:
    first, count = rng.randrange(len(content)), rng.choice([1, 50, 5000])
    return content[:first] + rng.randbytes(count) + content[first + count :]


BYTES: list[Callable[[bytes, random.Random], bytes]] = [flipped, cut, without_a_part, repeated, noise]


def swap(folder: Path, name: str, rng: random.Random) -> None:
    """Put another file of the run in the place of this one."""
    others = [path for path in sorted(folder.rglob("*")) if path.is_file() and path != folder / name]
    shutil.copyfile(rng.choice(others), folder / name)


def reshape(folder: Path, name: str, rng: random.Random) -> None:
    """Give one array of a file another shape, type or values."""
    with np.load(folder / name) as stored:
        arrays = dict(stored)
    key = rng.choice(sorted(arrays))
    old = np.atleast_1d(arrays[key])
    others = [old[:-1], old.ravel(), old[None], old[..., :1], np.concatenate([old, old]), old[:0], np.array(7)]
    if old.dtype.kind in "iuf":
        others += [old.astype(kind) for kind in ("S3", "c8", "i1", "f8", "?", "U4", "u8")]
        others += [-old, old + 1, old[::-1], old * 1000]
    arrays[key] = rng.choice(others)
    np.savez(folder / name, **arrays)


def tamper(folder: Path, rng: random.Random) -> tuple[str, bool]:
    """Spoil one file that commands read; its name, and whether the manifest says what it now is."""
    name = rng.choice(list(READ))
    before, way = (folder / name).read_bytes(), rng.random()
    if way < 0.2:
        swap(folder, name, rng)
    elif way < 0.5 and name.endswith(".npz"):
        reshape(folder, name, rng)
    else:
        (folder / name).write_bytes(rng.choice(BYTES)(before, rng))
    forged = rng.random() < 0.6
    if forged:
        forge(folder, name)
    return name, forged or (folder / name).read_bytes() == before


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:  # noqa: F811
    return shutil.copytree(whole, tmp_path / "run")


TIERS = [(0, 4), pytest.param(4, 426, marks=pytest.mark.sweep)]


@pytest.mark.parametrize(("first", "many"), TIERS)
def test_files_that_were_tampered_with_are_refused_in_a_line(first: int, many: int, folder: Path) -> None:
    kept = {name: (folder / name).read_bytes() for name in [*READ, "manifest.json"]}
    for seed in range(first, first + many):
        name, may_be_read = tamper(folder, random.Random(seed))
        for k in READ[name][-2:]:
            assert refused(commands(folder)[k]) or may_be_read, (seed, name, k)
        for each, content in kept.items():
            (folder / each).write_bytes(content)


@pytest.mark.parametrize(("first", "many"), TIERS)
def test_manifests_that_were_tampered_with_are_refused_in_a_line(first: int, many: int, folder: Path) -> None:
    text = (folder / "manifest.json").read_text()
    for seed in range(first, first + many):
        rng, manifest = random.Random(seed), json.loads(text)
        rng.choice(TREE)(*rng.choice(list(places(manifest))), rng)
        (folder / "manifest.json").write_text(json.dumps(manifest))
        every = commands(folder)
        refused(every[rng.randrange(len(every))])


@pytest.mark.parametrize(
    ("first", "many"),
    [pytest.param(0, 10, marks=pytest.mark.tools), pytest.param(10, 60, marks=pytest.mark.sweep)],
)
@pytest.mark.parametrize("name", ["lens.stl", "lens.3mf"])
def test_meshes_that_were_tampered_with_are_found_fit_or_not(name: str, first: int, many: int, folder: Path) -> None:
    """They may be repaired by other programs, so whatever they hold is checked, and not whether it was changed."""
    content = (folder / name).read_bytes()
    (folder / "lens.stl").unlink()  # which would be read first
    for seed in range(first, first + many):
        rng = random.Random(seed)
        (folder / name).write_bytes(rng.choice(BYTES)(content, rng))
        done = CliRunner().invoke(app, ["preflight", str(folder)])
        assert done.exit_code in (0, 1), (seed, done.output)
        assert isinstance(done.exception, SystemExit | None), (seed, done.exception)
        assert json.loads((folder / "preflight.json").read_text())["status"] in ("green", "grey", "amber", "red")
