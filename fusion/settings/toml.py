"""Settings files: reads TOML, reports errors with path, value and remedy, and writes settings with their meanings."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Sequence
from enum import Enum
from math import degrees
from pathlib import Path
from textwrap import wrap
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from fusion.settings.sentences import OWN_CHECK, UNKNOWN_NAME, Complaint, complaints, section_of
from fusion.settings.unit_hints import as_number, suggestion, too_large, unit_of
from vision.errors import InputError
from vision.limits import check_toml, check_values, read_text

WIDTH = 100
_DECIMAL_COMMA = re.compile(r"^[ \t]*(\w+[ \t]*=[ \t]*[+-]?\d+),(\d+)[ \t]*(?:#.*)?$", re.MULTILINE)
Config = TypeVar("Config", bound=BaseModel)


def read_toml(path: str | Path, example: str = "name = 1.5") -> dict[str, Any]:
    """Read a TOML file; the error for a file that is not TOML shows the line ``example``.

    Raises
    ------
    InputError
        If the file is missing or not TOML.
    """
    text = ""
    try:
        text = read_text(Path(path), "settings")
        check_toml(text)
        values = tomllib.loads(text)
        check_values(values)
        return values
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror or error}", file=path, remedy="check the path"
        ) from error
    except InputError:
        raise
    except (ValueError, RecursionError) as error:  # also for numbers of thousands of digits, or deep nesting
        comma = _DECIMAL_COMMA.search(text)
        remedy = f"write a decimal point: {comma[1]}.{comma[2]}" if comma else f"write lines like {example}"
        raise InputError(f"is not TOML: {error}", file=path, remedy=remedy) from error


def build(model: type[Config], values: dict[str, Any], file: str | Path | None = None) -> Config:
    """Make a configuration from the values of a file.

    Raises
    ------
    InputError
        With the first error in one line; unknown names before wrong values.
    """
    found = next(_booleans(model, values, ()), None)
    if found is not None:
        raise InputError(f"{found}: input should be a number", file=file)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        problem, remedy = _explain(complaints(error, model)[0])
        raise InputError(problem, file=file, remedy=remedy) from error


def _booleans(model: type[BaseModel], values: dict[str, Any], path: tuple[str, ...]) -> Iterator[str]:
    """Find numbers given as true or false, which pydantic would accept as 1 and 0."""
    for name, value in values.items():
        field = model.model_fields.get(name)
        inner = section_of(field) if field is not None else None
        if inner is not None:
            for part in value if isinstance(value, list | tuple) else [value]:
                if isinstance(part, dict):
                    yield from _booleans(inner, part, (*path, name))
        elif (
            isinstance(value, bool)
            and field is not None
            and bool not in (field.annotation, *get_args(field.annotation))
        ):
            yield f"{'.'.join((*path, name))} = {toml_value(value)}"


def _explain(complaint: Complaint) -> tuple[str, str | None]:
    """Return the error of a problem, with its remedy."""
    if complaint.kind == OWN_CHECK:
        return f"{complaint.dotted}: {complaint.message}" if complaint.path else complaint.message, None
    if complaint.kind == UNKNOWN_NAME:
        return _unknown(complaint)
    name, value, field = complaint.name, complaint.value, complaint.field
    remedies = [as_number(name, value)]
    if complaint.kind in ("less_than", "less_than_equal"):
        remedies.append(too_large(name, value))
    remedies.append(field.description if field and complaint.kind != "literal_error" else None)
    remedy = next((text for text in remedies if text), None)
    return f"{complaint.dotted} = {complaint.shown}: {complaint.message}", remedy


def _unknown(complaint: Complaint) -> tuple[str, str]:
    fields, name, value = complaint.model.model_fields, complaint.name, complaint.value
    if isinstance(value, dict):
        inside = [key for key in value if key in fields]
        sections = [known for known, field in fields.items() if section_of(field) is not None]
        problem = f"unknown setting {complaint.dotted} = {{...}}, a section"
        if inside:
            return problem, f"write {inside[0]} without a section, at the top of the file"
        if not sections:
            remedy = (
                "this file has none; those of a flight, such as [imu] and [camera], belong in its flight.toml"
            )
            return problem, remedy
        near = suggestion(name, None, dict.fromkeys(sections, ""))
        return problem, near or _listing(sections)
    plain = {known: field for known, field in fields.items() if section_of(field) is None}
    units = {known: unit_of(known, field.description) for known, field in plain.items()}
    near = suggestion(name, value, units)
    return f"unknown setting {complaint.dotted} = {value!r}", near or _listing(list(fields))


def _listing(names: list[str]) -> str:
    listed = f"known here: {', '.join(names)}" if names and len(names) <= 12 else ""
    return "; ".join(part for part in (listed, "`corridor config` lists them all") if part)


def settings_text(model: type[Config], command: str, file: str | Path | None = None) -> str:
    """Return the settings of a command as text from `config_toml`.

    Parameters
    ----------
    model
        The settings.
    command
        Command that uses them, such as ``corridor fuse FLIGHT``.
    file
        A settings file; None for the defaults.

    Raises
    ------
    InputError
        If the file cannot be read or used.
    """
    config = model() if file is None else build(model, read_toml(file), file)
    whose = "the defaults" if file is None else f"as {Path(file).name} makes them"
    return config_toml(
        config,
        f"Settings of `{command} --config`: {whose}. "
        "Settings that are deleted or left as comments keep their defaults.",
    )


def config_toml(config: BaseModel, heading: str) -> str:
    """Write a configuration as TOML with each setting's meaning, unit, bounds and default as comments.

    Reading it back gives the same configuration; a setting that is None is written as a comment, since TOML
    has no null.

    Parameters
    ----------
    config
        `fusion.FusionConfig` or `fusion.simulate.SimulationConfig`.
    heading
        Comment at the top, wrapped.
    """
    lines = [*_comment(heading), *_section_lines(config, ())]
    return "\n".join(lines).rstrip() + "\n"


def _section_lines(config: BaseModel, path: tuple[str, ...]) -> Iterator[str]:
    fields = type(config).model_fields
    plain = {name: field for name, field in fields.items() if section_of(field) is None}
    for name, field in plain.items():
        meaning = _meaning(name, field)
        yield from ["", *_comment(meaning)] if meaning or not path else ()
        yield _setting_line(name, field, getattr(config, name))
    for name, field in fields.items():
        inner = section_of(field)
        if inner is None:
            continue
        value, where = getattr(config, name), ".".join((*path, name))
        many = isinstance(value, tuple)
        for part in value if many else [value] if value is not None else []:
            yield ""
            yield from _comment(inner.__doc__.splitlines()[0]) if inner.__doc__ else ()
            yield f"[[{where}]]" if many else f"[{where}]"
            yield from _section_lines(part, (*path, name))
        if not value:
            yield ""
            yield from _comment((inner.__doc__ or "").splitlines()[0])
            yield f"# [[{where}]]" if many else f"# [{where}]"
            for inner_name, inner_field in inner.model_fields.items():
                default = None if inner_field.is_required() else inner_field.default
                yield f"# {_setting_line(inner_name, inner_field, default).removeprefix('# ')}"


def _setting_line(name: str, field: FieldInfo, value: Any) -> str:
    if value is None:
        return f"# {name} = ...{_remark(name, field, value)}"
    return f"{name} = {toml_value(value)}{_remark(name, field, value)}"


def description_of(field: FieldInfo) -> str:
    """Return a setting's meaning, worded for a settings file, which has no None."""
    return (field.description or "").replace(". None:", ". Not set:").replace("None:", "not set:")


def _meaning(name: str, field: FieldInfo) -> str:
    """Return the description without a leading unit, which is written beside the value."""
    text = description_of(field)
    rest = text.removeprefix(unit_of(name, text)).lstrip(";. ") if unit_of(name, text) else text
    return rest[:1].upper() + rest[1:]


def _comment(text: str) -> list[str]:
    return wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ")


def _remark(name: str, field: FieldInfo, value: Any) -> str:
    parts = [unit_of(name, field.description)]
    if isinstance(value, float) and parts[0].startswith("rad") and "sqrt" not in parts[0]:
        parts[0] += f" ({degrees(value):.4g} degrees{parts[0][3:]})"
    parts.append(_bounds(field))
    if value is None:
        parts.append("needed" if field.is_required() else "not set")
    elif not field.is_required() and value != field.default:
        parts.append("default: not set" if field.default is None else f"default {toml_value(field.default)}")
    text = "; ".join(part for part in parts if part)
    return f"  # {text}" if text else ""


def _bounds(field: FieldInfo) -> str:
    choices = get_args(field.annotation)
    if choices and all(isinstance(choice, str) for choice in choices):
        return _either(choices)
    if isinstance(field.annotation, type) and issubclass(field.annotation, Enum):
        return _either([str(member.value) for member in field.annotation])
    words = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    found = [
        f"{word} {getattr(rule, attribute):.4g}"
        for attribute, word in words.items()
        for rule in field.metadata
        if hasattr(rule, attribute)
    ]
    return " ".join(found)


def _either(words: Sequence[str]) -> str:
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def toml_value(value: Any) -> str:
    """Write a value as TOML: Boolean, number, text, enumeration member, or a list of these."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Enum):
        return toml_value(value.value)
    if isinstance(value, str):
        # TOML's basic strings use JSON's escapes, and also escape the delete character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, tuple | list):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    return repr(value)
