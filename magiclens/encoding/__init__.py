"""Encoders: sources are painted for a finished lens, or given ones edited (sections 5.2 and 7)."""
