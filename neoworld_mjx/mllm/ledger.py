"""Ledger of calls, tokens and dollars per role and model, and the cost cap that stops a run.

Prices are in USD per million tokens and are read from a YAML file. Each model has `input` and
`output`, and for servers that cache prompts `cache_read` and `cache_write`. The cost of a model
without a price is reported as unknown, not as zero.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ..config import read_yaml
from ..errors import BudgetError, ConfigError
from .requests import Rejection, Request, Usage

_DATE = re.compile(r"-(\d{8}|\d{4}-\d{2}-\d{2}|latest)$")
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
    return prices.get(model) or prices.get(_DATE.sub("", model))


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
    _rows: dict[tuple[str, str], _Row] = field(default_factory=dict)
    _reservations: list[float] = field(default_factory=list)
    _released: asyncio.Condition = field(default_factory=asyncio.Condition)

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

    @asynccontextmanager
    async def reserve(
        self, request: Request[Any], model: str, tokens: Usage
    ) -> AsyncIterator[None]:
        """Reserve the maximum cost of a call while the call is in progress.

        Most calls cost less than their reservation. A call that does not fit besides the
        reservations of other calls therefore waits until they end.

        Args:
            request: the request.
            model: name of the model.
            tokens: upper bound of the tokens of the call.

        Raises:
            BudgetError: the call could exceed the cap, or the model has no price, so that the cap
                cannot be enforced.
        """
        cap = self.max_cost_usd
        if cap is None:
            yield
            return
        bound_usd = self._cost_bound(model, tokens)
        async with self._released:
            while self.spent_usd + sum(self._reservations) + bound_usd > cap:
                if not self._reservations or self.spent_usd + bound_usd > cap:
                    raise BudgetError(
                        f"{request.name}: cost cap reached: {self.spent_usd:.4f} USD of {cap:g} "
                        f"are spent and this call may cost up to {bound_usd:.4f}; responses so "
                        "far are kept: raise mllm.max_cost_usd and resume the run"
                    )
                await self._released.wait()
            self._reservations.append(bound_usd)
        try:
            yield
        finally:
            async with self._released:
                self._reservations.remove(bound_usd)
                self._released.notify_all()

    def _cost_bound(self, model: str, tokens: Usage) -> float:
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

    def add(
        self,
        role: str,
        model: str,
        usage: Usage,
        *,
        billed: bool = True,
        failed: bool = False,
    ) -> None:
        """Add a call.

        Args:
            role: role of the model.
            model: name of the model.
            usage: tokens of the call.
            billed: if False, the call costs nothing.
            failed: if True, the call also counts as failed.
        """
        row = self._rows.setdefault((role, model), _Row())
        row.calls += 1
        row.failed += failed
        row.usage = row.usage + usage
        price = price_of(model, self.prices) if billed else Price(input=0, output=0)
        if price is not None and row.cost_usd is not None:
            row.cost_usd += price.cost(usage)
        elif usage != Usage():
            row.cost_usd = None

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
