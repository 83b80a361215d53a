"""An effect that a model may miss: what it is called, what it changes in the equations, and what it brings."""

from collections.abc import Mapping
from dataclasses import dataclass

from faultline.analysis.model import Differential, Parameter


@dataclass(frozen=True, kw_only=True)
class EffectParameter:
    """A parameter that an effect brings; `null` is its value where there is no effect, None if it has none."""

    unit: str
    description: str
    value: float
    null: float | None
    min: float | None
    max: float | None
    prior: float | None
    spread: float | None

    def in_model(self, source: str) -> Parameter:
        """The parameter as the model has it, at its null value."""
        return Parameter(
            unit=self.unit,
            description=self.description,
            value=self.value,
            min=self.min,
            max=self.max,
            prior=self.prior,
            spread=self.spread,
            source=source,
        )


@dataclass(frozen=True, kw_only=True)
class EffectUnknown:
    """A variable that an effect brings; a state has `initial` values, as in a model file."""

    unit: str
    description: str
    initial: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Change:
    """In every equation with all names of `where`, `symbol` becomes `replacement`."""

    where: tuple[str, ...]
    symbol: str
    replacement: str


@dataclass(frozen=True, kw_only=True)
class EffectEquation:
    """An equation `text` = 0 that an effect brings."""

    name: str
    description: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Effect:
    """An effect, in its own names; `place` says in messages where it is written.

    Each role has one name of a model a position; the first position of which a model has all names holds. One that is
    `expected` every such system has to some degree: it is tolerated, and not named.
    """

    name: str
    statement: str
    component: str
    source: str
    signature: str
    rivals: tuple[str, ...]
    separated_by: tuple[str, ...]
    roles: Mapping[str, tuple[str, ...]]
    parameters: Mapping[str, EffectParameter]
    unknowns: Mapping[str, EffectUnknown]
    changes: tuple[Change, ...]
    equations: tuple[EffectEquation, ...]
    differentials: tuple[Differential, ...]
    place: str
    expected: bool = False

    def prefixed(self, own: str) -> str:
        """What one of the effect's own names is in a model."""
        return f"{self.name}_{own}"

    @property
    def strengths(self) -> dict[str, EffectParameter]:
        """The parameters that have a null value, by their name in a model."""
        return {self.prefixed(name): p for name, p in self.parameters.items() if p.null is not None}
