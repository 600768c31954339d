"""What clicks set in motion: runs, files, projects, autosave. No viser."""
