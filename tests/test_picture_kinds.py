"""The kinds of pictures that people have, from the file to a spec that is right."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from magiclens.cli import app
from magiclens.contract.errors import InputError
from magiclens.images import art, luminance, read_image, to_display
from magiclens.images.movies import write_gif
from magiclens.plan.compile import load_plan
from magiclens.running.pipeline import run_spec

PANDA = np.rint(to_display(art("panda", 96)[..., 0]) * 255).astype(np.uint8)
INK = 255 - PANDA
SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10"><circle cx="5" cy="5" r="3"/></svg>'


def grey() -> Image.Image:
    return Image.fromarray(PANDA)


def on_nothing(level: int) -> Image.Image:
    """A drawing of one tone, all around it transparent."""
    return Image.fromarray(np.dstack([np.full((*INK.shape, 3), level, np.uint8), INK]))


def tall() -> Image.Image:
    picture = Image.new("L", (96, 300), 255)
    picture.paste(grey(), (0, 100))
    return picture


def heic(path: Path) -> None:
    import pillow_heif

    pillow_heif.from_pillow(grey().convert("RGB")).save(path)


SMALL = (
    "lens.facets=16",
    "lens.microfacets=8",
    "pipeline.renderers=[{type: tracer, resolution: 128, samples: 2}]",
    "report.analyses=[]",
)
KINDS: Mapping[str, Callable[[Path], Any]] = {
    "grey.png": lambda path: grey().save(path),
    "colours.jpg": lambda path: grey().convert("RGB").save(path, quality=90),
    "black-on-nothing.png": lambda path: on_nothing(0).save(path),
    "white-on-nothing.png": lambda path: on_nothing(255).save(path),
    "still.gif": lambda path: grey().convert("P").save(path),
    "deep.png": lambda path: Image.fromarray(PANDA.astype(np.uint16) * 257).save(path),
    "print.tif": lambda path: grey().convert("CMYK").save(path),
    "web.webp": lambda path: grey().convert("RGB").save(path),
    "bits.bmp": lambda path: grey().convert("1").save(path),
    "drawing.svg": lambda path: path.write_text(SVG),
    "phone.heic": heic,
    "tall.png": lambda path: tall().save(path),
}


def made(name: str, folder: Path) -> Path:
    KINDS[name](folder / name)
    return folder / name


def mlens(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(each) for each in arguments])


@pytest.mark.every_third
@pytest.mark.parametrize("name", KINDS)
def test_every_kind_of_picture_becomes_a_spec_that_is_right(name: str, tmp_path: Path) -> None:
    path, spec = made(name, tmp_path), tmp_path / "my.yaml"
    written = mlens("new", "single", path, "--out", spec)
    assert written.exit_code == 0, written.output
    checked = mlens("check", spec)
    assert checked.exit_code == 0, checked.output
    shown = to_display(luminance(load_plan(spec).scene().views[0].target))
    assert np.ptp(shown) > 0.9, "something is to be seen"
    assert shown[:2].min() > 0.9, "on a white ground"


@pytest.mark.sweep
@pytest.mark.parametrize("name", KINDS)
def test_a_small_lens_shows_it(name: str, tmp_path: Path) -> None:
    path, spec = made(name, tmp_path), tmp_path / "my.yaml"
    assert mlens("new", "single", path, "--out", spec).exit_code == 0
    run = run_spec(spec, tmp_path / "out", SMALL)
    assert run.manifest["views"][0]["ssim"] > 0.4


def test_a_white_logo_lies_on_black_and_the_spec_says_so(tmp_path: Path) -> None:
    path = made("white-on-nothing.png", tmp_path)
    light = read_image(path)
    assert light.min() == 0
    assert light.max() == 1
    mlens("new", "single", path, "--out", tmp_path / "my.yaml")
    assert "What is transparent is black" in " ".join((tmp_path / "my.yaml").read_text().replace("#", "").split())


@pytest.mark.parametrize("level", [0, 128, 200])
def test_what_shows_on_white_paper_stays_on_it(level: int, tmp_path: Path) -> None:
    on_nothing(level).save(tmp_path / "a.png")
    assert read_image(tmp_path / "a.png").max() == 1


def test_dark_letters_on_opaque_white_stay_on_white(tmp_path: Path) -> None:
    values = np.full((100, 100, 4), 255, np.uint8)
    values[:5, :5, 3] = 0
    values[50, 20:80, :3] = 0
    Image.fromarray(values).save(tmp_path / "card.png")
    assert read_image(tmp_path / "card.png")[0, 0].min() == 1


def test_tiny_pictures_are_refused_with_the_reason(tmp_path: Path) -> None:
    grey().resize((16, 31)).save(tmp_path / "icon.png")
    done = mlens("new", "single", tmp_path / "icon.png", "--out", tmp_path / "my.yaml")
    assert done.exit_code == 2
    assert "icon.png: it has 16 x 31 pixels, too few to show anything" in " ".join(done.stderr.split())
    assert not (tmp_path / "my.yaml").exists()
    spec = tmp_path / "other.yaml"
    spec.write_text("name: x\nscenario: {type: single, source: {type: circles}, target: {image: icon.png}}\n")
    assert "too few to show anything" in " ".join(mlens("check", spec).stderr.split())


@pytest.mark.parametrize(("crop", "fit"), [("auto", None), ("centre", "crop"), ("fit", None)])
def test_tall_pictures_are_made_square_as_one_likes(crop: str, fit: str | None, tmp_path: Path) -> None:
    done = mlens("new", "single", made("tall.png", tmp_path), "--out", tmp_path / "my.yaml", "--crop", crop)
    assert done.exit_code == 0, done.output
    plan: Any = load_plan(tmp_path / "my.yaml")
    assert plan.scenario.target.fit == fit


def test_another_way_to_crop_is_refused(tmp_path: Path) -> None:
    done = mlens("new", "single", made("tall.png", tmp_path), "--out", tmp_path / "my.yaml", "--crop", "center")
    assert done.exit_code == 2
    assert "did you mean 'centre'" in " ".join(done.stderr.split())


def animation(folder: Path) -> Path:
    frames = [np.asarray(art(f"worm-{k}", 64), np.float32) for k in range(3)]
    write_gif(folder / "anim.gif", frames, 5)
    return folder / "anim.gif"


def test_an_animation_is_all_of_its_frames(tmp_path: Path) -> None:
    spec = tmp_path / "my.yaml"
    done = mlens("new", "universal-animation", animation(tmp_path), "--out", spec)
    assert done.exit_code == 0, done.output
    assert "images: [anim.gif]" in spec.read_text()
    plan = load_plan(spec)
    first, _, third = plan.scene().views
    assert np.abs(first.target - third.target).max() > 0.5
    assert mlens("check", spec).exit_code == 0


def test_an_animation_is_no_picture_for_other_lenses(tmp_path: Path) -> None:
    done = mlens("new", "single", animation(tmp_path), "--out", tmp_path / "my.yaml")
    assert done.exit_code == 2
    assert "holds 3 pictures; save the one" in " ".join(done.stderr.split())
    assert "universal-animation" in done.stderr


@pytest.mark.parametrize(("name", "package"), [("drawing.svg", "resvg_py"), ("phone.heic", "pillow_heif")])
def test_a_missing_package_is_named(name: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = made(name, tmp_path)
    monkeypatch.setitem(sys.modules, package, None)  # as if it could not be imported
    with pytest.raises(InputError, match=r"pip install 'magiclens\[(svg|heic)\]', or save it as PNG"):
        read_image(path)


@pytest.mark.parametrize("part", ['<image href="/etc/hostname"/>', "<image xlink:href = 'a.png'/>"])
def test_a_drawing_shows_no_other_files(part: str, tmp_path: Path) -> None:
    (tmp_path / "a.svg").write_text(SVG.replace("</svg>", f"{part}</svg>"))
    with pytest.raises(InputError, match="shows other files"):
        read_image(tmp_path / "a.svg")


def test_a_broken_drawing_is_an_input_error(tmp_path: Path) -> None:
    (tmp_path / "a.svg").write_bytes(b"<svg \xff")
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path / "a.svg")
