"""How what is made anew with every sample is made: the parts of the state."""

from __future__ import annotations

made = tuple.__new__
"""Makes a ``NamedTuple`` of its class and all its fields, in order: its own constructor takes twice as long."""
