"""The interactive viewer: a finished lens on its source, to be moved about in a browser.

``viewer_fragment(run_dir)`` is an HTML ``<section>`` with style and script in it, at most ``MOST_BYTES`` long, to be
put into a page once; ``viewer_page(run_dir, title)`` is a whole page; ``write_view`` writes it to a file. They need no
other file and make no request, so that they work from ``file://`` too. Everything that users wrote is escaped.

The section traces rays as the built-in tracer does, for any position of lens and eye, in WebGL2; a browser without it
plays a short film of traced pictures instead. ``window.magiclens`` (``ready``, ``setPose``, ``settled``, ``capture``)
is for tests.
"""

from magiclens.web.viewer.page import viewer_fragment, viewer_page, write_view
from magiclens.web.viewer.viewer_data import MOST_BYTES

__all__ = ["MOST_BYTES", "viewer_fragment", "viewer_page", "write_view"]
