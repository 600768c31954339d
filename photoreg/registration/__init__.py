"""The whole refinement: settings, events, checkpoint, verdict."""
