"""The page that shows the sources of a run on a screen, at their true size, for the lens to be laid on.

It is one file that makes no request, so that it works offline, from ``file://``, and on a phone that it was sent to.
The size is calibrated with a bank card; every pixel of the screen gets the mean light over its area.
"""

from magiclens.web.screen.page import screen_page, write_screen

__all__ = ["screen_page", "write_screen"]
