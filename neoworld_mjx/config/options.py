"""Declare options: each in one place, with default, bounds, unit, meaning, and what a change costs.

    population: int = static("shapes arrays", 256, "Candidates of an iteration.", ge=2)

`list_options` reads the declarations back: the pages of options and the grouping of sweeps are
derived from that list.
"""

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticUndefined

Kind = Literal["host", "traced", "static"]
"""What a change of an option costs in the search.

host: nothing, the value acts outside of compiled code. traced: nothing, the value is an array that
compiled code takes. static: compiled code is another one, for the option's reason.
"""


class Options(BaseModel):
    """Base of all option groups: frozen, and closed against unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Option(NamedTuple):
    """One option as declared, with its path from the group that was listed."""

    path: str
    default: Any
    """As JSON and YAML hold it."""
    meaning: str
    unit: str
    kind: Kind
    reason: str
    """Why an option is static; of a traced one why it can still split a sweep, else empty."""
    values: tuple[str, ...]
    """The valid names, where the option takes one of a few."""
    bounds: str
    """Such as ">= 0"; empty without."""


def option(default: Any, meaning: str, *, unit: str = "", **bounds: Any) -> Any:
    """Declare an option that acts outside of compiled code.

    Args:
        default: the value without a configuration.
        meaning: one or two English sentences.
        unit: of the value.
        bounds: `ge`, `gt`, `le` and `lt`.
    """
    return _declared(default, meaning, unit, "host", "", bounds)


def traced(default: Any, meaning: str, *, unit: str = "", reason: str = "", **bounds: Any) -> Any:
    """Declare an option whose value is an array in compiled code; see `Option.reason`."""
    return _declared(default, meaning, unit, "traced", reason, bounds)


def static(reason: str, default: Any, meaning: str, *, unit: str = "", **bounds: Any) -> Any:
    """Declare an option whose other values compile another program; `reason` says why."""
    return _declared(default, meaning, unit, "static", reason, bounds)


def _declared(
    default: Any, meaning: str, unit: str, kind: Kind, reason: str, bounds: dict[str, Any]
) -> Any:
    extra: dict[str, Any] = {"unit": unit, "kind": kind, "reason": reason}
    return Field(default=default, description=meaning, json_schema_extra=extra, **bounds)


def list_options(group: Options | type[Options], at: str = "") -> Iterator[Option]:
    """List the options of a group and of the groups in it, in the order of declaration.

    Args:
        group: an instance, whose values are the defaults, or a class whose options all have one.
        at: path of the group, ending in a dot, or empty.
    """
    group = group() if isinstance(group, type) else group
    values = group.model_dump(mode="json")
    for name, field in type(group).model_fields.items():
        value = getattr(group, name)
        if isinstance(value, Options):
            yield from list_options(value, f"{at}{name}.")
            continue
        extra = field.json_schema_extra
        if not isinstance(extra, dict) or field.default is PydanticUndefined:
            raise TypeError(
                f"{type(group).__name__}.{name}: declare it by option, traced or static"
            )
        yield Option(
            path=at + name,
            default=values[name],
            meaning=field.description or "",
            unit=str(extra["unit"]),
            kind=extra["kind"],  # pyright: ignore[reportArgumentType]
            reason=str(extra["reason"]),
            values=_names(field.annotation),
            bounds=", ".join(map(_bound, field.metadata)),
        )


def option_values(options: Options, at: str = "") -> dict[str, Any]:
    """Return the values of all options by path, as JSON holds them; see `list_options`."""
    return {each.path: each.default for each in list_options(options, at)}


def _names(annotation: Any) -> tuple[str, ...]:
    return get_args(annotation) if get_origin(annotation) is Literal else ()


_SIGNS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def _bound(limit: Any) -> str:
    name = type(limit).__name__.lower()
    return f"{_SIGNS[name]} {getattr(limit, name):g}"
