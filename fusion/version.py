"""The project's version, said here alone: pyproject.toml, the command and the outputs take it from here."""

__version__ = "0.1.0"
