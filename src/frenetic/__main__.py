"""``python -m frenetic`` is the command line."""

from frenetic.cli import main

main()
