"""What programs and notebooks use: ``magiclens.run``, pictures and heights as arrays, the picture in a notebook."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from PIL import Image
from ruamel.yaml import YAML

import magiclens
from magiclens import Annealer, Assignment, InputError, Progress, Run, Scene, silent
from magiclens.contract.artifacts import Candidates
from magiclens.plan.registry import Registry
from toys import CANDIDATES, SPEC, TOYS, SpecWriter, ToyExporter, no_timings, registry_of

NOTEBOOKS = sorted(Path(__file__).parent.parent.glob("docs/notebooks/*.ipynb"))


@pytest.fixture(autouse=True)
def toys(
    registry: Registry, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Designing a lens takes no time, and the current folder is empty."""
    monkeypatch.setattr(Registry, "load", lambda: registry)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def spec() -> dict[str, Any]:
    """The toy spec as a dict."""
    data: dict[str, Any] = YAML(typ="safe").load(SPEC)
    return data


@pytest.fixture
def lens(spec: dict[str, Any], tmp_path: Path) -> Run:
    return magiclens.run(spec, tmp_path / "lens")


@pytest.mark.parametrize("first", ["", "import magiclens.running.pipeline; ", "from magiclens.cli import run as _; "])
def test_run_is_a_function_whatever_was_imported_before(first: str) -> None:
    code = f"{first}import magiclens; print(callable(magiclens.run), magiclens.run.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["True", "run"]


class Last(Annealer):
    """Chooses the last candidate of every facet, or one before it. No plugin brings it."""

    type: ClassVar[str] = "last"

    before: int = 0

    def anneal(
        self, scene: Scene, candidates: Candidates, rng: np.random.Generator, progress: Progress = silent
    ) -> Assignment:
        return Assignment.pick(candidates, np.full(candidates.errors.shape[:2], CANDIDATES - 1 - self.before))


def test_stages_of_ones_own_take_the_place_of_the_specs(spec: dict[str, Any], tmp_path: Path) -> None:
    runs = [
        magiclens.run(spec, tmp_path / f"lens-{before}", stages=[Last(before=before), ToyExporter()])
        for before in (0, 1)
    ]
    assert [set(run.result.assignment.choice.ravel()) for run in runs] == [{CANDIDATES - 1}, {CANDIDATES - 2}]
    chosen = {stage["kind"]: stage for stage in runs[1].manifest["stages"]}
    assert (chosen["annealer"]["type"], chosen["annealer"]["options"]["before"]) == ("last", 1)
    with pytest.raises(InputError, match="unknown annealer 'last'"):
        magiclens.open_run(runs[0].folder, registry_of(*TOYS))


def test_a_file_a_dict_and_a_spec_give_the_same_lens(
    write_spec: SpecWriter, spec: dict[str, Any], tmp_path: Path
) -> None:
    path = write_spec(("scenario:", "name: lens\nscenario:"))
    named = {**spec, "name": "lens"}
    loaded = magiclens.load_spec(path)
    runs = [magiclens.run(one, tmp_path / str(k)) for k, one in enumerate((path, str(path), named, loaded))]
    manifests = [no_timings(run.manifest) for run in runs]
    assert all(manifest == manifests[0] for manifest in manifests)


def test_the_run_folder_is_named_after_the_spec(spec: dict[str, Any], tmp_path: Path) -> None:
    assert magiclens.run({**spec, "name": "mine"}).folder == Path("out/mine")
    assert (tmp_path / "out" / "mine" / "manifest.json").exists()


def test_overrides_lie_over_a_dict_and_leave_it_alone(spec: dict[str, Any], tmp_path: Path) -> None:
    run = magiclens.run(spec, tmp_path / "out", ["lens.facets=3"])
    assert run.manifest["scene"]["facets"] == 3
    assert spec["lens"]["facets"] == 4


def test_tuples_and_paths_can_stand_in_a_dict(spec: dict[str, Any], grey_png: Path, tmp_path: Path) -> None:
    scenario = {**spec["scenario"], "targets": ({"image": grey_png}, {"art": "bat"})}
    run = magiclens.run({**spec, "scenario": scenario}, tmp_path / "out")
    assert (run.folder / "inputs" / "grey.png").is_file()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lens": {"facest": 3}}, "spec: lens.facest: unknown key; did you mean 'facets'?"),
        ({"seed": -1}, "spec: seed: must be at least 0, got -1"),
        ({"scenario": None}, "spec: scenario: expected a mapping such as {type: name}, got nothing"),
    ],
)
def test_mistakes_in_a_dict_are_named(spec: dict[str, Any], change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        magiclens.run({**spec, **change})
    assert str(caught.value).startswith(message)


def test_pictures_and_heights_are_arrays(lens: Run) -> None:
    assert lens.sources["source"].shape == (300, 300, 1)
    assert set(lens.targets) == {"rotation-000", "rotation-090"}
    assert lens.renders["tracer"]["rotation-090"].shape == (32, 32, 1)
    assert lens.heights.shape == (4, 4, 3, 3)
    assert not lens.heights.flags.writeable
    assert lens.scores["rotation-000"] == {
        key: lens.manifest["views"][0][key] for key in ("psnr_db", "ssim")
    }


def test_a_notebook_shows_the_contact_sheet(lens: Run) -> None:
    html = lens._repr_html_()
    found = re.search(r'src="data:image/png;base64,([^"]+)"', html)
    assert found
    with Image.open(io.BytesIO(base64.b64decode(found[1]))) as picture:
        assert picture.width <= 960
        assert np.asarray(picture.convert("L")).std() > 20
    assert re.search(r'alt="[^"]{10,}"', html)
    assert not re.search(r'(src|href)="(?!data:)', html)


def test_names_are_escaped_in_a_notebook(lens: Run) -> None:
    from dataclasses import replace

    named = replace(lens, result=replace(lens.result, manifest={**lens.manifest, "name": '<b onload="x">'}))
    assert "<b" not in named._repr_html_()
    assert "&lt;b onload=&quot;x&quot;&gt;" in named._repr_html_()


def test_what_a_run_is_called_fits_on_a_line(lens: Run, tmp_path: Path) -> None:
    assert repr(lens) == f"Run({str(tmp_path / 'lens')!r}: rotating, rotation-000, rotation-090)"


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebooks_in_the_docs_have_run(notebook: Path) -> None:
    cells = [cell for cell in nbformat.read(notebook, 4).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert sum("image/png" in out.get("data", {}) for cell in cells for out in cell.outputs) == 2


@pytest.mark.parametrize(
    "notebook",
    [
        pytest.param(path, id=path.stem, marks=pytest.mark.tools if path.stem == "first-lens" else pytest.mark.sweep)
        for path in NOTEBOOKS
    ],
)
def test_the_notebooks_in_the_docs_run(notebook: Path, tmp_path: Path) -> None:
    pages = nbformat.read(notebook, 4)
    size = '"facets": 20, "microfacets": 12'
    (first,) = [cell for cell in pages.cells if size in cell.source]
    first.source = first.source.replace(size, '"facets": 12, "microfacets": 4')
    done = NotebookClient(pages, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in done.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
    assert list(tmp_path.glob("out/*/lens.stl"))
