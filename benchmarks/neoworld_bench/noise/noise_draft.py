"""Add errors to an object one by one, so that the object always passes the checks of programs."""

from collections.abc import Callable

import numpy as np
from pydantic import ValidationError

from neoworld_mjx.checks.allowance import Allowance
from neoworld_mjx.checks.compile_checks import check
from neoworld_mjx.checks.signals import has_errors
from neoworld_mjx.config import ProgramOptions
from neoworld_mjx.spec import ObjectSpec

from .parse_noise import NoiseLog

TRIES = 8
"""Maximum number of samples of an error until one passes the checks."""
Variant = Callable[[ObjectSpec, np.random.Generator], ObjectSpec | None]


class Draft:
    """An object to which errors are added one by one.

    An error is kept only if the object with it passes the checks.
    """

    def __init__(
        self,
        spec: ObjectSpec,
        allowances: tuple[Allowance, ...],
        rng: np.random.Generator,
        log: NoiseLog,
    ) -> None:
        """Start from an object without errors, and the overlaps that its program allows."""
        self.spec, self.rng, self._allowances, self._log = spec, rng, allowances, log

    def change(self, kind: str, variant: Variant, *, noted: bool = True) -> None:
        """Add an error to the object.

        Args:
            kind: name of the error in the log.
            variant: function that samples an object with the error, or returns None if the object
                cannot have this error.
            noted: if True, the log notes that the error was injected. Errors that every object has
                are not noted.
        """
        for _ in range(TRIES):
            try:
                changed = variant(self.spec, self.rng)
                if changed is None or changed == self.spec:
                    return
                changed = ObjectSpec.model_validate(changed.model_dump())
            except ValidationError:
                continue
            if self._passes(changed):
                self.spec = changed
                if noted:
                    self._log.injected.append(kind)
                return
        self._log.refused.append(kind)

    def _passes(self, spec: ObjectSpec) -> bool:
        parts = {part.name for part in spec.parts}
        remaining = [a for a in self._allowances if {a.first, a.second} <= parts]
        return not has_errors(check(spec, ProgramOptions(), None, remaining))
