"""What all packages share and no user imports."""
