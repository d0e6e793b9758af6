"""Specs for people who have pictures and want a lens: ``mlens new``."""
