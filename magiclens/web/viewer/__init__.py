"""The interactive viewer: a finished lens on its source, to be moved about in a browser.

``fragment(run_dir)`` is a self-contained HTML ``<section>``, style and script included, at most ``MOST_BYTES`` long, to
be put into a page once; ``page(run_dir, title)`` is a whole page; ``write_view`` writes it to a file. They need nothing
else: no other file and no request, so that they work from ``file://`` too. Whatever users wrote is escaped.

The section traces rays as the built-in tracer does, for any place of lens and eye, in WebGL2; a browser without it
shows a plain picture. ``window.magiclens`` (``ready``, ``setPose``, ``settled``, ``capture``) is for tests.
"""

from magiclens.web.viewer.facts import MOST_BYTES
from magiclens.web.viewer.page import fragment, page, write_view

__all__ = ["MOST_BYTES", "fragment", "page", "write_view"]
