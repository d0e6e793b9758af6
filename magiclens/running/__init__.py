"""Executes plans: the pipeline, run folders, manifests, observers, jobs."""
