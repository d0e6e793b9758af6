"""``python -m magiclens`` is ``mlens``."""

from magiclens.cli import main

main()
