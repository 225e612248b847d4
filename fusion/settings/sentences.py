"""What pydantic finds wrong with settings, located in their models, and names that come close to a wrong one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

UNKNOWN_NAME = "extra_forbidden"  # pydantic's words for kinds of complaint
OWN_CHECK = "value_error"


@dataclass(frozen=True, slots=True)
class Complaint:
    """One thing that is wrong with settings.

    Parameters
    ----------
    kind
        Pydantic's word for it, such as `UNKNOWN_NAME`.
    path
        Names of tables, settings and numbers of members down to the wrong one; empty for the whole.
    value
        The value given.
    message
        Pydantic's sentence, in lower case; a model's own sentence where the kind is `OWN_CHECK`.
    model
        The model whose settings stand beside the wrong one.
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
        """What the model says of the setting; None if it is unknown."""
        return self.model.model_fields.get(self.name)

    @property
    def shown(self) -> str:
        """The value, a table shortened."""
        return "{...}" if isinstance(self.value, dict) else repr(self.value)


def complaints(error: ValidationError, model: type[BaseModel]) -> list[Complaint]:
    """Locate everything that pydantic found wrong with values for a model, unknown names first."""
    found = [_located(one, model) for one in error.errors()]
    return sorted(found, key=lambda complaint: complaint.kind != UNKNOWN_NAME)


def _located(error: Any, model: type[BaseModel]) -> Complaint:
    path: list[str] = []
    inside = model
    here: type[BaseModel] | None = model  # whose settings may come next; None below a plain value
    parts = [str(part) for part in error["loc"]]
    for number, part in enumerate(parts):
        field = here.model_fields.get(part) if here is not None else None
        is_unknown_name = error["type"] == UNKNOWN_NAME and number == len(parts) - 1
        if field is None and not part.isdigit() and not is_unknown_name:
            continue  # which member of a union pydantic tried
        path.append(part)
        inside = here or inside
        here = section_of(field) if field is not None else here
    own = error["type"] == OWN_CHECK
    message = str(error["ctx"]["error"]) if own else error["msg"][0].lower() + error["msg"][1:]
    return Complaint(error["type"], tuple(path), error["input"], message, inside)


def section_of(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of which a field holds one or several; None for a plain value."""
    return next(_models_in(field.annotation), None)


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def did_you_mean(name: str, known: Iterable[str], *, cutoff: float = 0.5) -> str | None:
    """Ask whether the nearest of the known names was meant; None if none is near."""
    near = get_close_matches(name[:100], list(known), n=1, cutoff=cutoff)
    return f"did you mean {near[0]}?" if near else None
