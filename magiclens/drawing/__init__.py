"""Figures drawn pixel by pixel, so that equal figures are equal files."""
