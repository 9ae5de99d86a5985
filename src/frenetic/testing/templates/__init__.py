"""Files that `frenetic init` writes for its user to edit."""
