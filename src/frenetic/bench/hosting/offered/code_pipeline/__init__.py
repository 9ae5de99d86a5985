"""The pipeline's package of that name."""
