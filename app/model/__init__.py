"""The app's state as frozen values, and its rules. No viser, no engine at work."""
