"""The studio: a local web app in which lenses are ordered, queued and looked at, one process, on this machine only."""
