"""What to try next: the Strategy protocol, its operators and its implementations."""
