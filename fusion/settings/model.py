"""Settings as pydantic models that report errors in one line, in Python and in files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

from fusion.settings.toml import build
from vision.errors import InputError

if TYPE_CHECKING:  # type checkers see the constructors as declared by pydantic
    from pydantic._internal._model_construction import ModelMetaclass as _Explained
else:

    class _Explained(type(BaseModel)):
        def __call__(cls, *unnamed: Any, **values: Any) -> Any:
            if unnamed:
                raise InputError(
                    f"{cls.__name__}({unnamed[0]!r}) does not say which setting this is",
                    remedy=f"name it, as in {cls.__name__}({next(iter(cls.model_fields))}=...)",
                )
            return build(cls, values)


class Settings(BaseModel, metaclass=_Explained):
    """Base of all settings: frozen, unknown names refused, no infinite numbers.

    Raises
    ------
    InputError
        From the constructor: a `ValueError` of one line with the setting, its value and the remedy.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
