"""Workers in their own processes on this machine."""
