"""From a spec and the installed plugins to a frozen plan."""
