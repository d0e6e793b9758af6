"""Preflight: checks whether the exported files of a run are fit to be made, shown on one page."""
