"""What may move in a refinement, and in which numbers."""
