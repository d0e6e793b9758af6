"""Writes specs for users' own pictures, for ``mlens new``."""
