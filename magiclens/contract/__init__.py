"""Everything that plugins rely on; read this folder first.

``artifacts`` are the data that stages exchange, ``stages`` and ``executors`` are the base classes of what a plugin
contributes, ``hookspecs`` are the functions by which it does so. ``checks`` say when a run rejects an artifact,
``units`` are the types of options with a unit, and ``errors`` are what a plugin may raise.
"""
