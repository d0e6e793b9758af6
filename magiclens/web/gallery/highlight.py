"""Colours for code."""

from __future__ import annotations

from markupsafe import Markup, escape

_LANGUAGES = {"sh": "bash", "yaml": "yaml", "python": "python", "json": "json", "toml": "toml"}
"""Names of languages in documents, and their names in Pygments."""


def highlighted(text: str, language: str) -> Markup:
    """Colour a text as HTML; if the language is not known, it is only escaped."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import get_lexer_by_name

    if language not in _LANGUAGES:
        return escape(text)
    return Markup(highlight(text, get_lexer_by_name(_LANGUAGES[language]), HtmlFormatter(nowrap=True)))
