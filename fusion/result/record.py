"""Results with types in Python and plain values in JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from enum import Enum
from typing import Any, ClassVar


class Record(Mapping[str, Any]):
    """Base of frozen dataclasses that are written as JSON objects.

    Attributes are typed; `to_dict` gives the JSON object, and ``record["name"]`` reads from it, so that a result
    in memory and its JSON can be used alike. Fields in ``optional`` are left out of the object while they are None.
    """

    __slots__ = ()
    optional: ClassVar[frozenset[str]] = frozenset()

    def to_dict(self) -> dict[str, Any]:
        """Return the plain values: dictionaries, lists, words, numbers and None."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {
            name: _plain(value)
            for name, value in values.items()
            if not (value is None and name in self.optional)
        }

    def __getitem__(self, key: str) -> Any:
        return self.to_dict()[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.to_dict())

    def __len__(self) -> int:
        return len(self.to_dict())


def _plain(value: Any) -> Any:
    if isinstance(value, Record):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Enum) else value
