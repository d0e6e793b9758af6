"""Programs for milling machines: toolpaths that cut a lens out of a plate, and the languages they are written in."""
