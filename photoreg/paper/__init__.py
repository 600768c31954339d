"""The paper's experiment again, from scene to report."""
