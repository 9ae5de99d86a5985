"""The command line: the program ``frenetic``, and ``python -m frenetic``.

Nothing is imported before Ctrl-C can be answered.
"""

import sys


def main() -> None:
    """Run the command line; Ctrl-C during its import ends in one line and exit code 130."""
    try:
        from frenetic.cli import main as run_command_line  # Ctrl-C may come during this import

        run_command_line()
    except KeyboardInterrupt:
        sys.stderr.write("frenetic: interrupted\n")
        sys.exit(130)  # `frenetic.cli.INTERRUPTED`, which may not have been imported yet


if __name__ == "__main__":
    main()
