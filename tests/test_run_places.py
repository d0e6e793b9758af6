"""Where runs may be written: what is at ``--out`` is replaced if a run has made it, and is never lost otherwise."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from magiclens.cli import app
from magiclens.contract.errors import InputError
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.folder import place_for, require_same_name
from magiclens.running.pipeline import run_plan
from magiclens.running.replacing import atomic_file, atomic_folder
from toys import SpecWriter

OURS = {"format": 1, "spec_sha256": "0" * 64, "artifacts": [{"path": "lens.stl", "sha256": "0" * 64, "bytes": 4}]}
"""What is enough of a manifest."""


@pytest.fixture
def run(write_spec: SpecWriter, registry: Registry, tmp_path: Path) -> Callable[[Path], Path]:
    """Runs the toy spec."""
    return lambda out: run_plan(load_plan(write_spec(), (), registry), out).folder


def a_run(out: Path, **changes: object) -> None:
    out.mkdir(parents=True)
    (out / "lens.stl").write_text("lens")
    (out / "manifest.json").write_text(json.dumps({**OURS, **changes}))


def with_notes(out: Path) -> None:
    a_run(out)
    (out / "notes.txt").touch()


def with_notes_deep_inside(out: Path) -> None:
    a_run(out)
    (out / "renders" / "mine").mkdir(parents=True)
    (out / "renders" / "mine" / "photo.jpg").touch()


def with_a_hidden_file(out: Path) -> None:
    a_run(out)
    (out / ".gitignore").touch()


def with_a_link_inside(out: Path) -> None:
    a_run(out)
    (out / "elsewhere").symlink_to("/")


def whose_lens_is_a_link(out: Path) -> None:
    a_run(out)
    (out / "lens.stl").rename(out.parent / "kept.stl")
    (out / "lens.stl").symlink_to(out.parent / "kept.stl")


def of_a_web_app(out: Path) -> None:
    out.mkdir()
    (out / "manifest.json").write_text('{"name": "my web app"}')
    (out / "precious").touch()


def with_a_manifest_alone(out: Path) -> None:
    out.mkdir()
    (out / "manifest.json").write_text('{"name": "my web app"}')


def with_a_list_as_manifest(out: Path) -> None:
    out.mkdir()
    (out / "manifest.json").write_text("[]")


def with_a_broken_manifest(out: Path) -> None:
    out.mkdir()
    (out / "manifest.json").write_bytes(b'{"format": 1, \xff')


def with_half_a_manifest(out: Path) -> None:
    a_run(out, artifacts="lens.stl")


def with_a_manifest_of_numbers(out: Path) -> None:
    a_run(out, artifacts=[1, 2])


def with_a_folder_as_manifest(out: Path) -> None:
    (out / "manifest.json").mkdir(parents=True)
    (out / "manifest.json" / "x").touch()


def without_a_manifest(out: Path) -> None:
    out.mkdir()
    (out / "thesis.tex").touch()


def a_file(out: Path) -> None:
    out.write_text("x")


def a_pipe(out: Path) -> None:
    os.mkfifo(out)


def a_link_to_nothing(out: Path) -> None:
    out.symlink_to(out.with_name("nothing"))


def a_link_to_a_file(out: Path) -> None:
    out.with_name("file").write_text("x")
    out.symlink_to(out.with_name("file"))


def a_link_to_a_folder_that_is_not_ours(out: Path) -> None:
    without_a_manifest(out.with_name("theirs"))
    out.symlink_to(out.with_name("theirs"))


def a_link_to_itself(out: Path) -> None:
    out.symlink_to(out)


def below_a_file(out: Path) -> None:
    out.parent.rmdir()
    out.parent.write_text("x")


NOT_OURS = [
    with_notes, with_notes_deep_inside, with_a_hidden_file, with_a_link_inside, whose_lens_is_a_link, of_a_web_app,
    with_a_manifest_alone, with_a_list_as_manifest, with_a_broken_manifest, with_half_a_manifest,
    with_a_manifest_of_numbers, with_a_folder_as_manifest, without_a_manifest, a_file, a_pipe, a_link_to_nothing,
    a_link_to_a_file, a_link_to_a_folder_that_is_not_ours, a_link_to_itself, below_a_file,
]  # fmt: skip


def listing(folder: Path) -> dict[str, object]:
    """Everything below a folder, links as links."""
    return {
        path.relative_to(folder).as_posix(): os.readlink(path)
        if path.is_symlink()
        else path.read_bytes()
        if path.is_file()
        else None
        for path in folder.rglob("*")
    }


@pytest.mark.parametrize("kind", NOT_OURS)
def test_what_is_not_ours_stays_and_stops_the_run_before_it_starts(
    kind: Callable[[Path], None], write_spec: SpecWriter, registry: Registry, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    out = tmp_path / "runs" / "out"
    out.parent.mkdir()
    kind(out)
    before = listing(tmp_path / "runs") if (tmp_path / "runs").is_dir() else {}
    monkeypatch.setattr("magiclens.running.pipeline.Steps", None)  # nothing of the run is begun
    monkeypatch.setattr(Registry, "load", lambda *_: registry)
    done = CliRunner().invoke(app, ["run", str(write_spec()), "--out", str(out), "--force"])
    assert done.exit_code == 2
    assert done.stderr.startswith("error: --out")
    assert done.stderr.count("\n") == 1
    assert (listing(tmp_path / "runs") if (tmp_path / "runs").is_dir() else {}) == before


@pytest.mark.parametrize("above", [False, True])
def test_the_working_folder_is_not_replaced(
    above: bool, run: Callable[[Path], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    a_run(tmp_path / "out")
    (tmp_path / "out" / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "out" / "empty" if above else tmp_path / "out")
    with pytest.raises(InputError, match="is in use as a folder and cannot be replaced"):
        run(tmp_path / "out" if above else Path())


def test_a_folder_that_cannot_be_written_is_found_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "locked")  # root may write everywhere
    (tmp_path / "locked").mkdir()
    with pytest.raises(InputError, match="cannot write in"):
        place_for(tmp_path / "locked" / "out")


def test_an_older_run_is_replaced_and_nothing_else_is_left(run: Callable[[Path], Path], tmp_path: Path) -> None:
    out = tmp_path / "runs" / "out"
    a_run(out)
    (out / ".DS_Store").touch()
    (out / "empty").mkdir()
    run(out)
    assert not (out / "lens.stl").exists()
    assert (out / "lens.toy").exists()
    assert os.listdir(out.parent) == ["out"]
    run(out)
    assert os.listdir(out.parent) == ["out"]


def test_the_run_of_a_spec_of_another_name_is_not_replaced(tmp_path: Path) -> None:
    a_run(tmp_path / "out", name="cat")
    require_same_name(tmp_path / "out", "cat")
    require_same_name(tmp_path / "nothing", "cat")
    with pytest.raises(InputError, match="is the run of another spec, 'cat'; choose another --out, or replace it with"):
        require_same_name(tmp_path / "out", "dog")


def test_an_empty_folder_is_filled_and_a_link_to_one_stays_a_link(run: Callable[[Path], Path], tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    for _ in range(2):
        run(tmp_path / "out")
        assert (tmp_path / "out").is_symlink()
        assert (tmp_path / "disk" / "manifest.json").is_file()


def killed_while(tmp_path: Path, work: str) -> None:
    """A process that ends by SIGKILL in the middle of some work on ``tmp_path / "out"``."""
    code = f"""
import os, sys
from pathlib import Path
from magiclens.running import replacing
place, kill = Path(sys.argv[1]), lambda *_: os.kill(os.getpid(), 9)
{work}
"""
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path / "out")], check=False)
    assert done.returncode == -9


def test_what_a_killed_run_leaves_is_removed_by_the_next(run: Callable[[Path], Path], tmp_path: Path) -> None:
    killed_while(tmp_path, "with replacing.atomic_folder(place) as folder: (folder / 'x').touch(); kill()")
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".mlens-")]
    assert not (tmp_path / "out").exists()
    run(tmp_path / "out")
    assert sorted(os.listdir(tmp_path)) == ["out", "toy.yaml"]


def test_a_run_that_was_being_replaced_is_put_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Killed between two renames, where the system cannot do both at once."""
    a_run(tmp_path / "out")
    killed_while(
        tmp_path,
        """
replacing.sys.platform = "another"
rename = Path.rename
Path.rename = lambda self, target: (rename(self, target), kill())
with replacing.atomic_folder(place) as folder: (folder / "x").touch()
""",
    )
    assert not (tmp_path / "out").exists()
    said: list[str] = []
    with atomic_folder(tmp_path / "out", said.append) as folder:
        assert (tmp_path / "out" / "lens.stl").read_text() == "lens"
        (folder / "new").touch()
    assert said == [f"'{tmp_path / 'out'}' was about to be replaced when the program was killed: it is back"]
    assert os.listdir(tmp_path) == ["out"]
    assert os.listdir(tmp_path / "out") == ["new"]


def test_another_process_that_is_still_at_work_is_left_alone(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "out") as one:
        (one / "one").touch()
        with atomic_folder(tmp_path / "out") as other:
            (other / "other").touch()
        assert (one / "one").exists()
    assert os.listdir(tmp_path / "out") == ["one"]
    assert os.listdir(tmp_path) == ["out"]


def test_a_number_that_another_process_has_now_is_no_sign_of_life(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "out"):
        (hidden,) = tmp_path.glob(".mlens-*")
        words = hidden.name.split("-")
        words[4] = "1"  # it began when the machine did
        shutil.copytree(hidden, tmp_path / "-".join(words))
    said: list[str] = []
    with atomic_folder(tmp_path / "out", said.append):
        pass
    assert len(said) == 1
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("length", [100, 255])
def test_names_may_be_as_long_as_the_system_allows(tmp_path: Path, length: int) -> None:
    with atomic_folder(tmp_path / ("x" * length)) as folder:
        (folder / "y").touch()
    with atomic_file(tmp_path / ("z" * length)) as path:
        path.touch()
    assert sorted(map(len, os.listdir(tmp_path))) == [length, length]


def test_a_folder_that_fails_leaves_the_older_one(tmp_path: Path) -> None:
    a_run(tmp_path / "out")
    with pytest.raises(ZeroDivisionError), atomic_folder(tmp_path / "out") as folder:
        (folder / "x").write_text(str(1 / 0))
    assert sorted(os.listdir(tmp_path / "out")) == ["lens.stl", "manifest.json"]
    assert os.listdir(tmp_path) == ["out"]
