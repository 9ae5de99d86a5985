"""``python -m frenetic`` is the command line."""

from frenetic.cli import main

if __name__ == "__main__":
    main()
