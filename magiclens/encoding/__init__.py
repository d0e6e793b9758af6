"""Painting sources for a finished lens (5.2), and editing given ones (7)."""
