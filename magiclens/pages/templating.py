"""The one jinja2 environment of all pages: report, preflight, sweep, viewer and gallery."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from urllib.parse import quote

from jinja2 import Environment, FunctionLoader, StrictUndefined

from magiclens.drawing.dark import for_dark_pages
from magiclens.pages.pictures import webp_uri


def render_page(template: str, **values: object) -> str:
    """Fill a template; everything in ``values`` is escaped unless it is Markup.

    Args:
        template: ``package/file``, the file being in the package's folder ``templates``.
        values: What the template names.

    Raises:
        jinja2.UndefinedError: The template names something that is not there.
    """
    return _environment().get_template(template).render(values)


def template_text(template: str) -> str:
    """The text of a file in the folder ``templates`` of a package, named as for ``render_page``."""
    package, _, name = template.partition("/")
    return (files(package) / "templates" / name).read_text(encoding="utf-8")


@cache
def colours() -> Mapping[str, Mapping[str, str]]:
    """The colours of all pages by name, in ``light``, in ``dark`` and on ``paper``, as the style sheet has them."""
    blocks = re.findall(r":root \{(.*?)\}", template_text("magiclens.pages/tokens.css"), re.DOTALL)
    found = [dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{3,6})\b", block)) for block in blocks]
    light, *others = filter(None, found)
    return dict(zip(("light", "dark", "paper"), (light, *({**light, **other} for other in others)), strict=True))


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FunctionLoader(template_text),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"webp_uri": webp_uri, "for_dark_pages": for_dark_pages, "quoted": quote}
    return environment
