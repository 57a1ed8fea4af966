"""One-line messages for pydantic's validation errors."""

from typing import Any

from pydantic import BaseModel, ValidationError

from ..errors import choices

_SECRET = "base_url"
"""Option whose invalid values are not displayed because they may contain API keys."""


def validation_message(error: ValidationError, model: type[BaseModel]) -> str:
    """Return a one-line message that lists each invalid key with its value or valid choices."""
    lines = []
    for item in error.errors():
        key = ".".join(str(step) for step in item["loc"]) or "(root)"
        if item["type"] == "extra_forbidden":
            keys = _keys_at(model, item["loc"][:-1])
            lines.append(f"unknown key {key}: {choices(str(item['loc'][-1]), keys)}")
        elif _SECRET in item["loc"]:
            lines.append(f"{key}: {item['msg']}")
        else:
            value = repr(item["input"])
            value = value if len(value) <= 80 else value[:77] + "..."
            lines.append(f"{key}: {item['msg']}, got {value}")
    return "; ".join(lines)


def _keys_at(model: type[BaseModel], path: tuple[Any, ...]) -> list[str]:
    for step in path:
        field = model.model_fields.get(str(step))
        inner = field.annotation if field is not None else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return []
        model = inner
    return sorted(model.model_fields)
