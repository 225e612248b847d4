"""Run the command line as ``python -m fusion``."""

from fusion.cli.app import main

main()
