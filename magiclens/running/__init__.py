"""Carries out plans: the pipeline, run folders, their manifests, observers, and jobs for executors."""
