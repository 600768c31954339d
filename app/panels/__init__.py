"""The tabs and folds of the page, one module each."""
