"""Is a run fit to be made? Looks at the files as exported, and says so on one page."""
