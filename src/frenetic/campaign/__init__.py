"""One search with its budget, on disk."""
