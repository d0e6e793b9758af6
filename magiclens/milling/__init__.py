"""Programs for milling machines, and what a machine makes of them."""
