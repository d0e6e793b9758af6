"""Tests see every stage run, and leave the user's cache alone."""

import os

os.environ["MLENS_CACHE_SIZE"] = "0"
