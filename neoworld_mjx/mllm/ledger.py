"""Ledger of calls, tokens and dollars per role and model, and the cost cap that stops a run.

Prices are in USD per million tokens and are read from a YAML file. Each model has `input` and
`output`, and for servers that cache prompts `cache_read` and `cache_write`. The cost of a model
without a price is reported as unknown, not as zero.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ..config import read_yaml
from ..errors import BudgetError, ConfigError
from .requests import Rejection, Request, Usage

_PACKAGE_PRICES = Path(__file__).with_name("prices.yaml")
_CHARS_PER_TOKEN = 2.5
_PIXELS_PER_TOKEN = 750
_SERVER_TOKENS = 600
"""Number of tokens that a server adds, such as the instructions for structured output."""


class Price(BaseModel):
    """Price of a model in USD per million tokens."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    input: float = Field(ge=0)
    output: float = Field(ge=0)
    cache_read: float | None = Field(default=None, ge=0)
    """If None, the price of `input`."""
    cache_write: float | None = Field(default=None, ge=0)
    """If None, the price of `input`."""

    def cost(self, usage: Usage) -> float:
        """Return the cost of a call [USD]."""
        read = self.input if self.cache_read is None else self.cache_read
        write = self.input if self.cache_write is None else self.cache_write
        micro = (
            usage.input * self.input
            + usage.output * self.output
            + usage.cache_read * read
            + usage.cache_write * write
        )
        return micro / 1e6


def load_prices(path: Path | None = None) -> dict[str, Price]:
    """Read the package's table of prices, with entries replaced or added from a user's file.

    Raises:
        ConfigError: the file is missing or not YAML, or an entry is invalid.
    """
    prices = _read_prices(_PACKAGE_PRICES)
    return prices if path is None else prices | _read_prices(Path(path))


def price_of(model: str, prices: dict[str, Price]) -> Price | None:
    """Return a model's price by its full name, or by its name without the date at its end."""
    if model in prices:
        return prices[model]
    stem, _, tail = model.rpartition("-")
    dated = (tail.isdigit() and len(tail) == 8) or tail == "latest"
    if dated:
        return prices.get(stem)
    for name, price in prices.items():
        suffix = model.removeprefix(name + "-")
        if suffix != model and suffix.replace("-", "").isdigit() and len(suffix) == 10:
            return price
    return None


def token_bound(
    request: Request[Any], max_tokens: int, rejected: Sequence[Rejection] = ()
) -> Usage:
    """Return an upper bound of the tokens of a call, with which its cost is reserved."""
    chars = len(request.system) + len(request.prompt) + 2 * len(str(request.json_schema))
    chars += sum(len(r.text) + len(r.message(request)) for r in rejected)
    pixels = sum(width * height for width, height in (p.size for p in request.pictures))
    tokens = int(chars / _CHARS_PER_TOKEN + pixels / _PIXELS_PER_TOKEN) + _SERVER_TOKENS
    # In the worst case, everything is written to the cache, which costs more than plain input.
    return Usage(cache_write=tokens, output=max_tokens)


@dataclass
class _Row:
    calls: int = 0
    failed: int = 0
    usage: Usage = field(default_factory=Usage)
    cost_usd: float | None = 0.0


@dataclass
class Ledger:
    """Calls, tokens and cost of a run, by role and model.

    Raises:
        ConfigError: the table of prices is invalid.
    """

    max_cost_usd: float | None = None
    prices: dict[str, Price] = field(default_factory=load_prices)
    fallbacks: dict[str, int] = field(default_factory=dict)
    _rows: dict[tuple[str, str], _Row] = field(default_factory=dict)
    _reservations: list[float] = field(default_factory=list)

    @property
    def reserved_usd(self) -> float:
        """Maximum cost of the calls in progress [USD]."""
        return sum(self._reservations, 0.0)

    @property
    def spent_usd(self) -> float:
        """Total cost so far of the calls to models with a price [USD]."""
        return sum((row.cost_usd or 0.0 for row in self._rows.values()), 0.0)

    @property
    def calls(self) -> int:
        """Number of calls so far."""
        return sum(row.calls for row in self._rows.values())

    @property
    def unpriced(self) -> list[str]:
        """Names of the called models that have no price."""
        return sorted({m for (_, m), row in self._rows.items() if row.cost_usd is None})

    def cost_bound(self, model: str, tokens: Usage) -> float:
        """Return the maximum cost of a call with these tokens [USD]; zero without a cap.

        Raises:
            BudgetError: a cap is set but cannot be enforced because the model has no price.
        """
        if self.max_cost_usd is None:
            return 0.0
        price = price_of(model, self.prices)
        if price is None:
            raise BudgetError(
                f"mllm.max_cost_usd is set but {model!r} has no price, so the cap cannot be "
                f"enforced: add its price to a YAML file and name the file in mllm.prices "
                f"(a local model: {{input: 0, output: 0}})"
            )
        # A server that does not cache prompts bills the same tokens as input.
        plain = Usage(input=tokens.cache_write, output=tokens.output)
        return max(price.cost(tokens), price.cost(plain))

    def fits(self, bound_usd: float, *, others: bool = True) -> bool:
        """Return True if a call stays within the cap.

        Args:
            bound_usd: maximum cost of the call.
            others: if True, include the reservations of other calls in progress.
        """
        if self.max_cost_usd is None:
            return True
        reserved = self.reserved_usd if others else 0.0
        return self.spent_usd + reserved + bound_usd <= self.max_cost_usd

    def reserve(self, bound_usd: float) -> None:
        """Reserve the maximum cost of a call."""
        self._reservations.append(bound_usd)

    def release(self, bound_usd: float) -> None:
        """Release the reservation of a call."""
        self._reservations.remove(bound_usd)

    def cap_error(self, request: Request[Any], bound_usd: float) -> BudgetError:
        """Return the error of a call that could exceed the cap."""
        return BudgetError(
            f"{request.name}: cost cap reached: {self.spent_usd:.4f} USD of "
            f"{self.max_cost_usd:g} are spent and this call may cost up to {bound_usd:.4f}; "
            f"responses so far are kept: raise mllm.max_cost_usd and resume the run"
        )

    def add(
        self,
        role: str,
        model: str,
        usage: Usage,
        *,
        billed: bool = True,
        failed: bool = False,
        share: float = 1.0,
    ) -> None:
        """Add a call.

        Args:
            role: role of the model.
            model: name of the model.
            usage: tokens of the call.
            billed: if False, the call costs nothing.
            failed: if True, the call also counts as failed.
            share: price of the call as a fraction of the list price.
        """
        row = self._rows.setdefault((role, model), _Row())
        row.calls += 1
        row.failed += failed
        row.usage = row.usage + usage
        price = price_of(model, self.prices) if billed else Price(input=0, output=0)
        if price is not None and row.cost_usd is not None:
            row.cost_usd += share * price.cost(usage)
        elif usage != Usage():
            row.cost_usd = None

    def add_fallback(self, note: str) -> None:
        """Count a note about a feature that the server does not support."""
        self.fallbacks[note] = self.fallbacks.get(note, 0) + 1

    def to_json(self) -> dict[str, Any]:
        """Return the ledger for run.json; `cost_usd` is null if any cost is unknown."""
        total = sum((row.usage for row in self._rows.values()), Usage())
        return {
            "calls": self.calls,
            "failed_calls": sum(row.failed for row in self._rows.values()),
            "tokens": asdict(total),
            "cost_usd": None if self.unpriced else round(self.spent_usd, 6),
            "known_cost_usd": round(self.spent_usd, 6),
            "models_without_price": self.unpriced,
            "max_cost_usd": self.max_cost_usd,
            "fallbacks": dict(sorted(self.fallbacks.items())),
            "by_role_and_model": [
                {
                    "role": role,
                    "model": model,
                    "calls": row.calls,
                    "failed_calls": row.failed,
                    "tokens": asdict(row.usage),
                    "cost_usd": None if row.cost_usd is None else round(row.cost_usd, 6),
                }
                for (role, model), row in sorted(self._rows.items())
            ],
        }

    def add_earlier(self, earlier: dict[str, Any]) -> None:
        """Add the ledger of an interrupted run, as returned by `to_json`."""
        for entry in earlier["by_role_and_model"]:
            row = self._rows.setdefault((entry["role"], entry["model"]), _Row())
            row.calls += entry["calls"]
            row.failed += entry["failed_calls"]
            row.usage = row.usage + Usage(**entry["tokens"])
            cost_known = row.cost_usd is not None and entry["cost_usd"] is not None
            row.cost_usd = row.cost_usd + entry["cost_usd"] if cost_known else None
        for note, count in earlier["fallbacks"].items():
            self.fallbacks[note] = self.fallbacks.get(note, 0) + count


def _read_prices(path: Path) -> dict[str, Price]:
    data = read_yaml(path, "prices")
    try:
        return TypeAdapter(dict[str, Price]).validate_python(data or {})
    except ValidationError as error:
        first = error.errors()[0]
        path_in_file = ".".join(str(step) for step in first["loc"])
        raise ConfigError(
            f"prices {path}: {path_in_file}: {first['msg']}; each model needs input and output, "
            f"optionally cache_read and cache_write, in USD per million tokens"
        ) from None
