"""Renderers: what the eye of each view sees through the finished solid."""
