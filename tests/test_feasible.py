"""What passes ``mlens check`` can be run: estimates of memory and time, and what they refuse."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from magiclens.cli import app
from magiclens.contract.errors import InputError
from magiclens.plan.compile import load_plan
from magiclens.plan.registry import Registry
from magiclens.running.estimate import estimate
from magiclens.running.feasible import MEMORY_VARIABLE, duration_text, memory_bytes, require_feasible

SPECS = Path(__file__).parent.parent / "specs"
INSTALLED = Registry.load()

TOO_MUCH = {
    "mesh": (["lens.microfacets=256", "lens.facets=64"], "lens.microfacets: the mesh would take about "),
    "mesh of many facets": (["lens.facets=512"], "lens.facets: the mesh would take about "),
    "raster of the search": (["pipeline.matcher.step=0.01mm", "lens.size=2m"], "pipeline.matcher.step: the search"),
    "tracer": (
        ["pipeline.renderers=[{type: tracer, resolution: 4096, samples: 16}]"],
        "pipeline.renderers.0.resolution: the renderer tracer would take about ",
    ),
    "discs": (
        ["scenario.source.radius=[0.05mm, 0.05mm]", "scenario.source.size=10m"],
        "scenario.source.radius: the pictures would take about ",
    ),
    "dart throwing": (
        ["pipeline.matcher={type: dart-throwing, reach: 100%}", "lens.facets=128"],
        "pipeline.matcher.reach: the dart throwing would take about ",
    ),
}


@pytest.mark.parametrize("case", TOO_MUCH)
def test_what_this_machine_cannot_hold_is_refused_with_the_key_to_change(
    case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(MEMORY_VARIABLE, "24GB")
    settings, message = TOO_MUCH[case]
    with pytest.raises(InputError) as raised:
        require_feasible(load_plan(SPECS / "single.yaml", settings, INSTALLED))
    text = str(raised.value)
    assert any(text.startswith(f"--set {setting}: ") for setting in settings)
    assert message in text
    assert "this machine has 24 GB; use " in text


def test_a_run_without_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MEMORY_VARIABLE, "1000TB")
    matcher = "{type: exhaustive, step: 0.01mm, window: 200%, scales: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]}"
    settings = [f"pipeline.matcher={matcher}", "lens.facets=512"]
    with pytest.raises(InputError, match=r"matcher\.step: the search would take about \d+ years of processor time"):
        require_feasible(load_plan(SPECS / "single.yaml", settings, INSTALLED))


def test_the_line_of_the_key_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MEMORY_VARIABLE, "1GB")
    spec = tmp_path / "a.yaml"
    spec.write_text((SPECS / "single.yaml").read_text().replace("microfacets: 22", "microfacets: 88"))
    line = next(k for k, text in enumerate(spec.read_text().splitlines(), 1) if "microfacets: 88" in text)
    for command in ("check", "plan", "run"):
        done = CliRunner().invoke(app, [command, str(spec)])
        assert done.exit_code == 2
        assert f"error: {spec}:{line}: lens.microfacets: the mesh would take about" in done.output


@pytest.mark.parametrize("spec", sorted(SPECS.glob("*.yaml")), ids=lambda spec: spec.stem)
def test_shipped_specs_fit_a_small_laptop(spec: Path) -> None:
    needs = estimate(load_plan(spec, [], INSTALLED))
    assert needs.bytes < 6e9
    assert 5 < needs.seconds < 12 * 3600


def test_sixty_million_triangles_fit_into_twelve_gib() -> None:
    needs = estimate(load_plan(SPECS / "fine-detail.yaml", ["lens.facets=512"], INSTALLED))
    assert needs.files["lens.stl"] > 3e9
    assert all(part.bytes < 12 * 2**30 for part in needs.parts if part.name in ("mesh", "heights"))


def test_plan_says_the_estimate() -> None:
    done = CliRunner().invoke(app, ["plan", str(SPECS / "single.yaml")])
    last = done.stdout.splitlines()[-1]
    assert last.startswith("estimate ")
    assert last.endswith(" of processor time, lens.stl of 54.5 MB")


@pytest.mark.parametrize(
    "setting", ["lens.microfacets=44", "lens.facets=64", "scenario.source.size=270mm", "pipeline.matcher.step=0.01mm"]
)
def test_an_estimate_grows_with_what_it_is_made_of(setting: str) -> None:
    plain, more = (estimate(load_plan(SPECS / "single.yaml", s, INSTALLED)) for s in ([], [setting]))
    assert more.bytes > plain.bytes
    assert more.seconds >= plain.seconds


def test_a_printers_lens_takes_longer_and_analyses_count() -> None:
    spec = SPECS / "printed-single.yaml"
    whole, unasked, facets_alone = (
        estimate(load_plan(spec, settings, INSTALLED)).seconds
        for settings in ([], ["report.analyses=[]"], ["lens.cells=eye"])
    )
    assert whole > unasked + 20
    assert whole > facets_alone + 60


def test_memory_is_what_the_machine_or_the_environment_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(MEMORY_VARIABLE, raising=False)
    there = memory_bytes()
    assert there is None or 1e8 < there < 1e15
    monkeypatch.setenv(MEMORY_VARIABLE, "3GB")
    assert memory_bytes() == 3e9
    monkeypatch.setenv(MEMORY_VARIABLE, "plenty")
    with pytest.raises(InputError, match="MLENS_MEMORY: 'plenty' is no size"):
        memory_bytes()


def test_durations_have_one_digit() -> None:
    assert [duration_text(s) for s in (0, 44, 130, 3000, 9000, 200000, 1e9)] == [
        f"{text} of processor time"
        for text in ("1 seconds", "40 seconds", "2 minutes", "50 minutes", "2 hours", "2 days", "30 years")
    ]


@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(["lens.size=25mm", "lens.facets=8"], marks=pytest.mark.tools),
        pytest.param(
            ["lens.facets=16", "lens.microfacets=64", "pipeline.integrator.refinement=1"], marks=pytest.mark.sweep
        ),
    ],
)
def test_the_estimate_is_not_far_from_what_a_run_takes(settings: list[str], tmp_path: Path) -> None:
    spec, settings = SPECS / "single.yaml", [*settings, "pipeline.renderers=[{type: tracer}]"]
    overrides = [part for setting in settings for part in ("--set", setting)]
    run = ["run", str(spec), "--no-cache", "--quiet", "--out", "out", *overrides]
    code = f"""if True:
        import json, time
        from pathlib import Path
        from magiclens.cli import app
        began = time.process_time()
        assert not app({run!r}, standalone_mode=False)  # what it returns is an exit status, if it fails
        # not getrusage: its peak is that of the process which started this one, where that was larger
        (peak,) = [line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line]
        print(json.dumps([1024 * int(peak), time.process_time() - began]))
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    taken_bytes, taken_seconds = json.loads(done.stdout.splitlines()[-1])
    needs = estimate(load_plan(spec, settings, INSTALLED))
    assert taken_bytes / 2 < needs.bytes < 3 * taken_bytes
    assert taken_seconds / 4 < needs.seconds < 4 * taken_seconds
