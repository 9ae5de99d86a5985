"""The embedded simulator: a dynamic single-track car in compiled code, headless and fast."""
