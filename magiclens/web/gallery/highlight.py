"""Code in colours."""

from __future__ import annotations

from markupsafe import Markup, escape

LANGUAGES = {"sh": "bash", "yaml": "yaml", "python": "python", "json": "json", "toml": "toml"}
"""What a page may call a language, and what the highlighter calls it."""


def highlighted(text: str, language: str) -> Markup:
    """HTML of a text in one of the languages above; of any other, only escaped."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import get_lexer_by_name

    if language not in LANGUAGES:
        return escape(text)
    return Markup(highlight(text, get_lexer_by_name(LANGUAGES[language]), HtmlFormatter(nowrap=True)))
