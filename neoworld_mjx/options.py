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
"""Cost of a change of an option in the search.

host: nothing, the value acts outside of compiled code. traced: nothing, the value is an array that
compiled code takes. static: compiled code is another one, for the option's reason.
"""


class PaperDifference(NamedTuple):
    """Where a default departs from the paper."""

    value: Any
    """What the paper does; `configs/paper.yaml` sets it."""
    reason: str
    """Why the default is another, as one English sentence."""
    effect: str = ""
    """What was measured, with n, here and as in the paper; ablations of the search say it else."""


class Options(BaseModel):
    """Base of all option groups: frozen, and closed against unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Option(NamedTuple):
    """One option as declared, with its path from the group that was listed."""

    path: str
    default: Any
    """As in JSON and YAML."""
    meaning: str
    unit: str
    kind: Kind
    reason: str
    """Reason why an option is static, or why a traced one can split a sweep; else empty."""
    values: tuple[str, ...]
    """The valid names, where the option takes one of a few."""
    bounds: str
    """Such as ">= 0"; empty without."""
    difference: PaperDifference | None
    """Where the default departs from the paper; None where it does not, or the paper leaves it
    open."""


def option(default: Any, meaning: str, **more: Any) -> Any:
    """Declare an option that acts outside of compiled code.

    Args:
        default: the value without a configuration.
        meaning: one or two English sentences.
        more: `unit` of the value; `departure` from the paper; `ge`, `gt`, `le` and `lt`.
    """
    return _declared(default, meaning, "host", **more)


def traced(default: Any, meaning: str, **more: Any) -> Any:
    """Declare an option whose value is an array in compiled code.

    Args:
        default: the value without a configuration.
        meaning: one or two English sentences.
        more: as of `option`, and a `reason`; see `Option.reason`.
    """
    return _declared(default, meaning, "traced", **more)


def static(reason: str, default: Any, meaning: str, **more: Any) -> Any:
    """Declare an option whose other values compile another program; `reason` says why."""
    return _declared(default, meaning, "static", reason=reason, **more)


def _declared(
    default: Any,
    meaning: str,
    kind: Kind,
    *,
    unit: str = "",
    reason: str = "",
    difference: PaperDifference | None = None,
    **bounds: Any,
) -> Any:
    extra: dict[str, Any] = {"unit": unit, "kind": kind, "reason": reason, "difference": difference}
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
            difference=extra["difference"],  # pyright: ignore[reportArgumentType]
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
