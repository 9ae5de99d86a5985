"""Parts of a run, such as drivers: their names, versions and records, and whose code is loaded."""
