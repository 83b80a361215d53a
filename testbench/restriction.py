"""A filter, orifice or open valve: pressure drop with a laminar and a turbulent part.

    dp = R q + K q |q|

Source: P. Forchheimer (1901) for porous beds, S. Ergun (1952) for their transition from laminar to turbulent; for a
sharp orifice the linear part is the fall of the discharge coefficient at small Reynolds numbers.
"""

from dataclasses import dataclass

TURBULENT = 1e-5
"""The laminar share of what counts as turbulent: none at all would have no slope at rest to compute with."""


@dataclass(frozen=True)
class Restriction:
    """`R` [Pa s/m^3], `K` [Pa s^2/m^6]."""

    R: float
    K: float

    @classmethod
    def rated(cls, drop: float, flow: float, laminar_share: float) -> "Restriction":
        """The restriction with `drop` [Pa] at `flow` [m^3/s], of which the part `laminar_share` [0..1] is laminar."""
        return cls(R=laminar_share * drop / flow, K=(1 - laminar_share) * drop / flow**2)

    def blocked(self, lost: float) -> "Restriction":
        """The same with the fraction `lost` [0..1) of its pores blocked: the rest carry the flow at higher velocity.

        Per pore dp = a v + b v^2 with v = q / A, so R grows with 1/A and K with 1/A^2.
        """
        left = 1.0 - lost
        return Restriction(R=self.R / left, K=self.K / left**2)

    def rebalanced(self, laminar_share: float, flow: float) -> "Restriction":
        """The restriction with the same drop at `flow` [m^3/s], of which another part is laminar."""
        return Restriction.rated(self.drop(flow), flow, max(laminar_share, TURBULENT))

    def drop(self, flow: float) -> float:
        """Pressure drop [Pa] at `flow` [m^3/s]; odd in the flow."""
        return (self.R + self.K * abs(flow)) * flow
