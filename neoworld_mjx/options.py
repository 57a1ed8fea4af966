"""Declaration of options: default, bounds, unit and meaning.

    population: int = option(256, "Candidates per iteration.", ge=2)

`list_options` lists the declarations. The pages that document options are derived from this list.
"""

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticUndefined


class PaperDifference(NamedTuple):
    """Difference between the default of an option and the paper."""

    value: Any
    """Value in the paper, which `configs/paper.yaml` sets."""
    reason: str
    """Why the default differs from the paper, in one English sentence."""


class Options(BaseModel):
    """Base class of all option groups. Instances are frozen, and unknown keys are rejected."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Option(NamedTuple):
    """Declaration of one option."""

    path: str
    """Path of the option from the listed group, with dots."""
    default: Any
    """Default in JSON form."""
    meaning: str
    unit: str
    values: tuple[str, ...]
    """Valid names of an enumerated option."""
    bounds: str
    """Bounds such as ">= 0"; empty if there are none."""
    difference: PaperDifference | None
    """Difference from the paper; None if there is none or the paper does not specify the value."""


def option(
    default: Any,
    meaning: str,
    *,
    unit: str = "",
    difference: PaperDifference | None = None,
    **bounds: Any,
) -> Any:
    """Declare an option.

    Args:
        default: default value.
        meaning: one or two English sentences.
        unit: unit of the value; empty if it has none.
        difference: difference from the paper.
        bounds: `ge`, `gt`, `le` and `lt`.
    """
    extra: dict[str, Any] = {"unit": unit, "difference": difference}
    return Field(default=default, description=meaning, json_schema_extra=extra, **bounds)


def list_options(group: Options | type[Options], prefix: str = "") -> Iterator[Option]:
    """List the options of a group and its subgroups, in the order of declaration.

    Args:
        group: an instance, whose values are listed as defaults, or a class in which every option
            has a default.
        prefix: path of the group, ending in a dot, or empty.
    """
    group = group() if isinstance(group, type) else group
    values = group.model_dump(mode="json")
    for name, field in type(group).model_fields.items():
        value = getattr(group, name)
        if isinstance(value, Options):
            yield from list_options(value, f"{prefix}{name}.")
            continue
        extra = field.json_schema_extra
        if not isinstance(extra, dict) or field.default is PydanticUndefined:
            raise TypeError(f"{type(group).__name__}.{name}: declare it with option")
        literal = get_origin(field.annotation) is Literal
        yield Option(
            path=prefix + name,
            default=values[name],
            meaning=field.description or "",
            values=get_args(field.annotation) if literal else (),
            bounds=", ".join(map(_bound, field.metadata)),
            **extra,  # pyright: ignore[reportArgumentType]
        )


def option_values(options: Options, prefix: str = "") -> dict[str, Any]:
    """Return the values of all options in JSON form, by path; see `list_options`."""
    return {option.path: option.default for option in list_options(options, prefix)}


_SIGNS = {"ge": ">=", "gt": ">", "le": "<=", "lt": "<"}


def _bound(constraint: Any) -> str:
    name = type(constraint).__name__.lower()
    return f"{_SIGNS[name]} {getattr(constraint, name):g}"
