"""The viewer as HTML: a section for other pages, and a page of its own."""

from __future__ import annotations

from pathlib import Path

from markupsafe import Markup

from magiclens.pages.templating import render_page, template_text
from magiclens.profiles.machines import Printer
from magiclens.running.manifest import REFERENCE_RENDERER, render_path, source_path
from magiclens.running.open_run import OpenRun, open_run
from magiclens.running.run_files import verified
from magiclens.web.embedding import json_for_script, write_beside
from magiclens.web.viewer.film import film_uri
from magiclens.web.viewer.pictures import thumbnail_uri
from magiclens.web.viewer.viewer_data import viewer_data

_PICTURE_SIDE = 320
"""Width and height of the picture for browsers that cannot run the viewer, pixels."""
_SHADERS = {
    "top": "top.glsl",
    "light": "light.glsl",
    "bench": "bench.glsl",
    "behind": "bench.frag.glsl",
    "table": "table.frag.glsl",
    "screen": "screen.vert.glsl",
    "shown": "screen.frag.glsl",
    "solidPoints": "solid.vert.glsl",
    "solid": "solid.frag.glsl",
}
"""Files of the shaders by their name in the script; vertex and fragment shader of the solid both follow ``top``, and
all that shows the sheet follows ``light``."""
_SCRIPTS = (
    "lens.js", "webgl.js", "table.js", "solid.js", "page.js", "pace.js", "poses.js", "look.js", "geometry.js",
    "words.js", "painter.js", "motion.js", "links.js", "input.js", "controls.js", "projector.js", "gif.js", "mp4.js",
    "film.js", "main.js",
)  # fmt: skip
"""Parts of the script in the order in which they are joined: constants are used only after their part."""


def viewer_fragment(run_dir: Path) -> str:
    """The viewer of a finished run as a ``<section>``; see the docstring of the package.

    Raises:
        InputError: It is no run folder, or its finisher made a mesh that cannot be traced again.
    """
    lens = open_run(run_dir)
    data = viewer_data(lens)
    view, fabrication = lens.scene.views[0], lens.plan.fabrication
    return render_page(
        "magiclens.web.viewer/section.html",
        name=_name(lens.folder),
        view=view.name,
        picture=thumbnail_uri(_fallback_picture(lens), _PICTURE_SIDE),
        film=film_uri(lens),
        side=_PICTURE_SIDE,
        kept=len(data["views"]),
        dropped=data["dropped"],
        bears=bool(data["bears"]),
        tops=len(data["tops"]),
        printer=fabrication.name if fabrication and isinstance(fabrication.machine, Printer) else None,
        data=Markup(json_for_script(data)),
        script=Markup(_script()),
    )


def viewer_page(run_dir: Path, title: str | None = None) -> str:
    """A whole page with the viewer of a finished run.

    Args:
        run_dir: The run folder.
        title: Heading of the page; the name of the run by default.

    Raises:
        InputError: As ``viewer_fragment``.
    """
    section = Markup(viewer_fragment(run_dir))
    return render_page("magiclens.web.viewer/viewer.html", title=title or _name(Path(run_dir)), section=section)


def write_view(run_dir: Path, out: Path | None = None) -> Path:
    """Write the viewer's page, whole or not at all.

    Args:
        run_dir: The run folder.
        out: The file to write; ``view.html`` in the run folder by default.

    Returns:
        The file that was written.

    Raises:
        InputError: ``out`` is a folder, or as ``viewer_fragment``.
    """
    return write_beside(run_dir, out or run_dir / "view.html", lambda: viewer_page(run_dir))


def _name(folder: Path) -> str:
    return str(verified(folder).manifest["name"])


def _fallback_picture(lens: OpenRun) -> Path:
    """The picture for browsers without WebGL2: the first view as rendered, or its source if nothing was rendered."""
    view = lens.scene.views[0]
    rendered = render_path(REFERENCE_RENDERER, view)
    return lens.files.file(rendered if lens.files.has(rendered) else source_path(view))


def _script() -> str:
    """One classic script that defines nothing but ``window.magiclens``; pages from file:// cannot load modules."""
    shaders = json_for_script({name: _file(file) for name, file in _SHADERS.items()})
    body = "\n".join(_file(file) for file in _SCRIPTS)
    return f'(() => {{\n"use strict";\nconst SHADERS = {shaders};\n{body}}})();'


def _file(name: str) -> str:
    return template_text(f"magiclens.web.viewer/{name}")
