"""Templates of the files that `frenetic init` writes."""
