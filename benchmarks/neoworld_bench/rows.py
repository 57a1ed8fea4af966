"""Rows of a benchmark: logging and conversion to JSON."""

import logging
from collections.abc import Iterable
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict

log = logging.getLogger(__name__)


class Row(BaseModel):
    """Base of the rows of tables: frozen, closed against unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_Row = TypeVar("_Row", bound=BaseModel)


def collect(rows: Iterable[_Row]) -> list[_Row]:
    """Return all rows, and log each as soon as it is known."""
    collected = []
    for row in rows:
        collected.append(row)
        fields = {k: v for k, v in row.model_dump().items() if v not in (None, "", [], "ok")}
        log.info(", ".join(f"{key} {_short(value)}" for key, value in fields.items()))
    return collected


def column_types(row: type[BaseModel]) -> dict[str, type]:
    """Return the columns of a kind of row with their types: bool, int, float or str."""
    return {
        name: next(
            kind for kind in (bool, int, float, str) if field.annotation in (kind, kind | None)
        )
        for name, field in row.model_fields.items()
    }


def plain(rows: Iterable[BaseModel]) -> list[dict[str, Any]]:
    """Return rows as JSON."""
    return [row.model_dump() for row in rows]


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
