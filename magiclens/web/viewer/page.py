"""The viewer as HTML."""

from __future__ import annotations

import html
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from magiclens.contract.errors import InputError
from magiclens.running.folder import MANIFEST, atomic_file
from magiclens.running.manifest import REFERENCE_RENDERER, refresh_manifest, render_path, source_path
from magiclens.running.open_run import OpenRun, open_run
from magiclens.web.viewer.facts import facts
from magiclens.web.viewer.pictures import small

PLAIN = 320
"""Pixels of the picture for browsers that cannot run the viewer."""
SHADERS = {
    "top": "top.glsl",
    "table": "table.frag.glsl",
    "screen": "screen.vert.glsl",
    "shown": "screen.frag.glsl",
    "solidPlaces": "solid.vert.glsl",
    "solid": "solid.frag.glsl",
}
SCRIPTS = (
    "lens.js", "draw.js", "table.js", "solid.js", "state.js", "places.js", "moves.js", "hands.js", "controls.js",
    "main.js",
)  # fmt: skip

PAGE = """\
<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>
body {{ margin: 0; background: #f6f7f9; color: #1c2128; font: 16px/1.5 system-ui, sans-serif; }}
main {{ max-width: 1080px; margin: 0 auto; padding: 20px 16px 48px; }}
h1 {{ margin: 0 0 12px; font-size: 26px; letter-spacing: -.01em; overflow-wrap: anywhere; }}
@media (prefers-color-scheme: dark) {{ body {{ background: #14171b; color: #e6e9ed; }} }}
</style>
</head>
<body>
<main>
<h1>{title}</h1>
{section}</main>
</body>
</html>
"""


def fragment(run_dir: Path) -> str:
    """The viewer of a finished run as a ``<section>``; see the package's docstring.

    Raises InputError if it is no run folder, or if its finisher made a mesh that cannot be traced again.
    """
    lens = open_run(run_dir)
    told = facts(lens)
    return _section(lens, told)


def page(run_dir: Path, title: str | None = None) -> str:
    """A whole page with the viewer of a finished run, headed by ``title``: the run's name by default."""
    section = fragment(run_dir)
    return PAGE.format(title=html.escape(title or _name(Path(run_dir))), section=section)


def write_view(run_dir: Path, out: Path | None = None) -> Path:
    """Write the page, whole or not at all, to ``out``; ``view.html`` in the run folder by default. Returns where it is.

    Raises InputError if ``out`` is a folder, or as ``fragment`` does.
    """
    path = out or run_dir / "view.html"
    if path.is_dir():
        raise InputError(f"'{path}' is a folder; name a file, such as {path / 'view.html'}", "--out")
    text = page(run_dir)
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    if path.resolve().is_relative_to(run_dir.resolve()):
        refresh_manifest(run_dir)
    return path


def _name(folder: Path) -> str:
    return str(json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["name"])


def _section(lens: OpenRun, told: dict[str, Any]) -> str:
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    view = lens.scene.views[0]
    return environment.from_string(_template("viewer.html")).render(
        name=_name(lens.folder),
        view=view.name,
        picture=small(_plain_picture(lens), PLAIN),
        side=PLAIN,
        kept=len(told["views"]),
        dropped=told["dropped"],
        style=Markup(_template("viewer.css")),
        facts=Markup(_for_script(told)),
        script=Markup(_script()),
    )


def _plain_picture(lens: OpenRun) -> Path:
    """What the first view shows; its source if the run was not rendered."""
    view = lens.scene.views[0]
    seen = lens.folder / render_path(REFERENCE_RENDERER, view)
    return seen if seen.is_file() else lens.folder / source_path(view)


def _script() -> str:
    """One classic script that leaves nothing but ``window.magiclens`` behind."""
    shaders = _for_script({name: _template(file) for name, file in SHADERS.items()})
    body = "\n".join(_template(file) for file in SCRIPTS)
    return f'(() => {{\n"use strict";\nconst SHADERS = {shaders};\n{body}}})();'


def _for_script(value: Any) -> str:
    """JSON that may stand within ``<script>``: nothing in it can end the element or begin a comment."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e")


def _template(name: str) -> str:
    return (files("magiclens.web.viewer") / "templates" / name).read_text(encoding="utf-8")
