"""Run folders that were damaged, edited or made up: one message, exit code 2, and no byte of them is believed."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.sparse import csr_array, load_npz, save_npz
from typer.testing import CliRunner

from lenses import Lenses
from magiclens.cli import app

ENCODED = "universal-animation"


@pytest.fixture(scope="module")
def whole(lenses: Lenses) -> Path:
    return lenses.shipped(ENCODED).folder


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return shutil.copytree(whole, tmp_path / "run")


def commands(folder: Path) -> list[list[str]]:
    """Commands that open a run."""
    source = str(folder / "sources" / "frame-00.png")
    out = str(folder.parent / "out.png")
    return [
        ["decode", str(folder), source, "-o", out],
        ["encode", str(folder), source, "-o", out],
        ["view", str(folder), "--no-open", "--out", str(folder.parent / "view.html")],
        ["preflight", str(folder)],
        ["show", str(folder), "--no-open", "--out", str(folder.parent / "show.html")],
    ]


def refused(arguments: list[str]) -> bool:
    """Whether a command ends with 2 and one line."""
    done = CliRunner().invoke(app, arguments)
    unfit = arguments[0] == "preflight" and done.exit_code == 1 and not done.stderr  # so it was read
    if done.exit_code == 0 or unfit:
        return False
    assert done.exit_code == 2, done.output
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    return True


def rewrite(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the manifest."""
    manifest = json.loads((folder / "manifest.json").read_text())
    change(manifest)
    (folder / "manifest.json").write_text(json.dumps(manifest))


def forge(folder: Path, name: str) -> None:
    """Let the manifest say of a file what it now is."""
    content = (folder / name).read_bytes()

    def update(manifest: dict[str, Any]) -> None:
        listed = next(artifact for artifact in manifest["artifacts"] if artifact["path"] == name)
        listed.update(sha256=hashlib.sha256(content).hexdigest(), bytes=len(content))

    rewrite(folder, update)


def flipped(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 0x10]) + content[middle + 1 :]


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "flipped": flipped,
    "truncated": lambda content: content[: len(content) // 2],
    "emptied": lambda content: b"",
    "longer": lambda content: content + b"\0",
    "no text": lambda content: b"\xff\xfe" + content,
    "another": lambda content: b"{}",
}
READ = {
    "spec.yaml": (0, 1, 2, 3, 4),
    "heights.npz": (2,),
    "transports/frame-00.npz": (0, 1),
    "sources/frame-01.png": (2, 3, 4),
    "targets/frame-00.png": (2, 3),
    "renders/tracer/frame-00.png": (2, 3),
}
"""Files, and which of the commands read them."""


@pytest.mark.parametrize(
    "damage", ["flipped", *(pytest.param(name, marks=pytest.mark.tools) for name in DAMAGES if name != "flipped")]
)
@pytest.mark.parametrize("name", READ)
def test_a_file_that_was_changed_is_not_read(name: str, damage: str, folder: Path) -> None:
    path = folder / name
    path.write_bytes(DAMAGES[damage](path.read_bytes()))
    for k in READ[name]:
        assert refused(commands(folder)[k]), k


@pytest.mark.parametrize("name", sorted({*READ} - {"transports/frame-00.npz"}))  # which may be deleted to save room
def test_a_file_that_is_missing_is_named(name: str, folder: Path) -> None:
    (folder / name).unlink()
    assert all(refused(commands(folder)[k]) for k in READ[name])


def manifest_of(text: str | bytes) -> Callable[[Path], None]:
    content = text.encode() if isinstance(text, str) else text
    return lambda folder: (folder / "manifest.json").write_bytes(content) and None


def with_key(key: str, value: object) -> Callable[[Path], None]:
    return lambda folder: rewrite(folder, lambda manifest: manifest.update({key: value}))


def with_view(key: str, value: object) -> Callable[[Path], None]:
    return lambda folder: rewrite(folder, lambda manifest: manifest["views"][0].update({key: value}))


def with_file(key: str, value: object) -> Callable[[Path], None]:
    return lambda folder: rewrite(folder, lambda manifest: manifest["artifacts"][0].update({key: value}))


def without(key: str) -> Callable[[Path], None]:
    return lambda folder: rewrite(folder, lambda manifest: manifest.pop(key))


MANIFESTS: dict[str, Callable[[Path], None]] = {
    "empty": manifest_of(""),
    "an empty mapping": manifest_of("{}"),
    "a list": manifest_of("[]"),
    "a number": manifest_of("1"),
    "half": manifest_of('{"format": 1, "name": "x"'),
    "no text": manifest_of(b"\xff\xfe\x00"),
    "deep": manifest_of("[" * 100_000),
    "of a newer magiclens": with_key("format", 99),
    "of no format": with_key("format", "one"),
    "without views": with_key("views", []),
    "views are text": with_key("views", "all"),
    "views are numbers": with_key("views", [1]),
    "a view elsewhere": with_view("source", "../../../etc/passwd"),
    "a view at an absolute path": with_view("target", "/etc/passwd"),
    "a render elsewhere": with_view("renders", {"tracer": "../x.png"}),
    "an eye that is none": with_view("eye_mm", [0, 0]),
    "an eye nowhere": with_view("eye_mm", [0, 0, None]),
    "a file elsewhere": with_file("path", "../spec.yaml"),
    "a hash that is none": with_file("sha256", "0"),
    "a size below nothing": with_file("bytes", -1),
    **{f"without {key}": without(key) for key in ("format", "name", "scene", "views", "stages", "artifacts")},
}


@pytest.mark.every_third
@pytest.mark.parametrize("kind", MANIFESTS)
def test_a_manifest_that_is_wrong_is_refused(kind: str, folder: Path) -> None:
    MANIFESTS[kind](folder)
    assert all(refused(command) for command in commands(folder))


def heights(change: Callable[[Any], Any], key: str = "heights_mm") -> Callable[[Path], str]:
    def spoil(folder: Path) -> str:
        with np.load(folder / "heights.npz") as stored:
            found = stored["heights_mm"]
        np.savez_compressed(folder / "heights.npz", **{key: change(found)})
        return "heights.npz"

    return spoil


def matrix(change: Callable[[Any], None]) -> Callable[[Path], str]:
    def spoil(folder: Path) -> str:
        name = "transports/frame-00.npz"
        found = csr_array(load_npz(folder / name))
        change(found)
        save_npz(folder / name, found)
        return name

    return spoil


def with_more_light(found: Any) -> None:
    found.data[0] = 7


def with_no_number(found: Any) -> None:
    found.data[0] = np.nan


def pointing_beyond(found: Any) -> None:
    found.indices += 10**9


def pointing_before(found: Any) -> None:
    found.indices -= 100


def running_backwards(found: Any) -> None:
    found.indptr[1] = found.indptr[-1] + 5


def of_another_lens(folder: Path) -> str:
    path = folder / "transports" / "frame-00.npz"
    found = csr_array(load_npz(path))
    save_npz(path, found[:100, :1000])
    return "transports/frame-00.npz"


def a_bomb(folder: Path) -> str:
    """A small file that holds a gigabyte of zeros."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (16_000, 16_000)})
    with zipfile.ZipFile(folder / "heights.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("heights_mm.npy", header.getvalue() + bytes(10**8))
    return "heights.npz"


def pickled(folder: Path) -> str:
    np.savez(folder / "heights.npz", heights_mm=np.array([{"a": 1}], dtype=object))
    return "heights.npz"


def of_more_facets(folder: Path) -> str:
    path = folder / "spec.yaml"
    path.write_text(path.read_text().replace("facets: 8", "facets: 9"))
    return "spec.yaml"


FORGERIES: dict[str, tuple[Callable[[Path], str], tuple[int, ...]]] = {
    "one axis less": (heights(lambda h: h[0]), (2,)),
    "another lens": (heights(lambda h: h[:4, :4]), (2,)),
    "no numbers": (heights(lambda h: h * np.nan), (2,)),
    "sky-high": (heights(lambda h: (h + 1) * 1e30), (2,)),
    "another key": (heights(lambda h: h, "other"), (2,)),
    "words": (heights(lambda h: h.astype(str)), (2,)),
    "a bomb": (a_bomb, (2,)),
    "pickled": (pickled, (2,)),
    "more facets": (of_more_facets, (2,)),
    "more light": (matrix(with_more_light), (0, 1)),
    "no light": (matrix(with_no_number), (0, 1)),
    "beyond": (matrix(pointing_beyond), (0, 1)),
    "before": (matrix(pointing_before), (0, 1)),
    "backwards": (matrix(running_backwards), (0, 1)),
    "of another lens": (of_another_lens, (0, 1)),
}


@pytest.mark.every_third
@pytest.mark.parametrize("kind", FORGERIES)
def test_what_is_made_up_is_found_out_whatever_the_manifest_says(kind: str, folder: Path) -> None:
    spoil, which = FORGERIES[kind]
    forge(folder, spoil(folder))
    assert all(refused(commands(folder)[k]) for k in which)


def test_a_spec_that_names_files_elsewhere_is_refused(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "sources" / "frame-00.png", tmp_path / "secret.png")
    yaml, path = YAML(), folder / "spec.yaml"
    spec = yaml.load(path.read_text())
    spec["scenario"]["source"] = {"type": "image", "path": "../secret.png"}
    with path.open("w") as file:
        yaml.dump(spec, file)
    forge(folder, "spec.yaml")
    assert all(refused(command) for command in commands(folder))


@pytest.mark.parametrize("name", ["sources/frame-01.png", "targets/frame-00.png", "renders/tracer/frame-00.png"])
def test_a_picture_that_is_none_is_found_out_whatever_the_manifest_says(name: str, folder: Path) -> None:
    (folder / name).write_bytes((folder / name).read_bytes()[:100])
    forge(folder, name)
    assert all(refused(commands(folder)[k]) for k in (2, 3))


def test_what_is_whole_is_read(folder: Path) -> None:
    assert not any(refused(command) for command in commands(folder))


@pytest.mark.parametrize("command", ["view", "preflight", "show"])
def test_a_command_that_writes_into_the_folder_vouches_for_nothing_else_in_it(command: str, folder: Path) -> None:
    """A file that it has not read is as damaged as before; and what the user keeps there is not the run's."""
    transport, notes = folder / "transports" / "frame-00.npz", folder / "notes.txt"
    transport.write_bytes(flipped(transport.read_bytes()))
    notes.write_text("mine")
    assert not refused([command, str(folder), *(["--no-open"] if command != "preflight" else [])])
    listed = {artifact["path"] for artifact in json.loads((folder / "manifest.json").read_text())["artifacts"]}
    assert f"{command}.html" in listed
    assert refused(commands(folder)[0])
    assert refused(["run", str(folder / "spec.yaml"), "--out", str(folder), "--force"])
    assert notes.read_text() == "mine"
