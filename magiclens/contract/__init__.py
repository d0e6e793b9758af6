"""What plugins rely on: artifacts, contracts of stages and executors, hooks, units, errors. Read this first."""
