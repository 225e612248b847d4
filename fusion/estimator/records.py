"""Fast construction of the named tuples that are created for every sample."""

from __future__ import annotations

new_record = tuple.__new__
"""``new_record(Class, (a, b, ...))`` is ``Class(a, b, ...)`` of a ``NamedTuple``, all fields in order, in half the
time."""
