"""Photos from files."""
