"""Pydantic's errors in settings, located in their models, and names similar to an unknown one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

UNKNOWN_NAME = "extra_forbidden"  # pydantic's names of kinds of errors
OWN_CHECK = "value_error"


@dataclass(frozen=True, slots=True)
class Complaint:
    """One error in settings.

    Parameters
    ----------
    kind
        Pydantic's name of it, such as `UNKNOWN_NAME`.
    path
        Names of tables and settings, and indices, down to the wrong one; empty for the whole.
    value
        The value given.
    message
        Pydantic's sentence, in lower case; a model's own sentence if the kind is `OWN_CHECK`.
    model
        The model of the wrong setting.
    """

    kind: str
    path: tuple[str, ...]
    value: Any
    message: str
    model: type[BaseModel]

    @property
    def name(self) -> str:
        """The last name of the path."""
        return self.path[-1]

    @property
    def dotted(self) -> str:
        """The path as it is written in TOML."""
        return ".".join(self.path)

    @property
    def field(self) -> FieldInfo | None:
        """The model's field of the setting; None if it is unknown."""
        return self.model.model_fields.get(self.name)

    @property
    def shown(self) -> str:
        """The value, a table shortened."""
        return "{...}" if isinstance(self.value, dict) else repr(self.value)


def complaints(error: ValidationError, model: type[BaseModel]) -> list[Complaint]:
    """Locate all errors that pydantic found in values for a model, unknown names first."""
    found = [_located(one, model) for one in error.errors()]
    return sorted(found, key=lambda complaint: complaint.kind != UNKNOWN_NAME)


def _located(error: Any, model: type[BaseModel]) -> Complaint:
    path: list[str] = []
    inside = model
    here: type[BaseModel] | None = model  # model of the next settings; None below a plain value
    parts = [str(part) for part in error["loc"]]
    for number, part in enumerate(parts):
        field = here.model_fields.get(part) if here is not None else None
        is_unknown_name = error["type"] == UNKNOWN_NAME and number == len(parts) - 1
        if field is None and not part.isdigit() and not is_unknown_name:
            continue  # the member of a union that pydantic tried
        path.append(part)
        inside = here or inside
        here = section_of(field) if field is not None else here
    own = error["type"] == OWN_CHECK
    message = str(error["ctx"]["error"]) if own else error["msg"][0].lower() + error["msg"][1:]
    return Complaint(error["type"], tuple(path), error["input"], message, inside)


def section_of(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a field's value or members; None for a plain value."""
    return next(_models_in(field.annotation), None)


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def did_you_mean(name: str, known: Iterable[str], *, cutoff: float = 0.5) -> str | None:
    """Suggest the nearest of the known names; None if none is near."""
    near = get_close_matches(name[:100], list(known), n=1, cutoff=cutoff)
    return f"did you mean {near[0]}?" if near else None
