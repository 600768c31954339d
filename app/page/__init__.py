"""The page that puts it all together, and the program that serves it."""
