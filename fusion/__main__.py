"""Run the command line: the entry point of the script ``corridor`` and of ``python -m fusion``."""

from fusion.cli.interrupts import leave_at_once


def main() -> None:
    """Load the commands and run them."""
    leave_at_once()
    from fusion.cli.app import main as run

    run()


if __name__ == "__main__":
    main()
