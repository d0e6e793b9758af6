"""Exporters: files that a printer, a mill or another program reads."""
