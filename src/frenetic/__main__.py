"""The command line: the program ``frenetic``, and ``python -m frenetic``.

Nothing is imported before Ctrl-C can be answered.
"""

import sys


def main() -> None:
    """Run the command line. Ctrl-C while it is imported is one line and exit code 130, too."""
    try:
        from frenetic.cli import main as run_command_line  # Ctrl-C may come meanwhile

        run_command_line()
    except KeyboardInterrupt:
        sys.stderr.write("frenetic: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
