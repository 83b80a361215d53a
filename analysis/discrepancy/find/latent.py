"""What unknown amplitudes explain of a calibrated model's misfit, with the calibration's own freedom integrated out.

    W (y - f(x)) = W J dx + W D a + v,    x + dx ~ N(0, I),    a ~ N(0, sigma^2 R R'),    v ~ N(0, I)

with the whitening W of `analysis.calibration.noise`, the derivatives J at the fit's x, and in D's columns what an
unknown input does in each of its cells. dx is taken out by least squares, once. Then the eigenvalues l and vectors V of
G = R'D'DR (of what is left of D) give the marginal likelihood for every intensity sigma at once, with h = V'R'D'e:

    2 ln p(sigma)/p(0) = sum over j of  sigma^2 h_j^2 / (1 + sigma^2 l_j) - ln(1 + sigma^2 l_j)

If nothing is missing h_j ~ N(0, l_j): that is all the law of the maximum needs. The idea of giving a suspect equation a
random walk and looking whether its intensity is zero is Kristensen, Madsen and Jorgensen's (Automatica 40, 2004).
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from faultline.analysis.calibration.noise import Weigh
from faultline.analysis.calibration.problem import Problem, Runs

Array = npt.NDArray[np.float64]

AT_BOUND = 1e-3
"""So near to a bound in standard deviations of the prior, an unknown does not move."""

SIGMAS = np.geomspace(1e-4, 10.0, 41)
"""Where the intensity is looked for, relative to the size of the input."""


@dataclass(frozen=True)
class Known:
    """What is known of x from elsewhere: what is `free` (n,) is x + N(0, (root' root)^-1), the rest is as it is."""

    free: npt.NDArray[np.bool_]
    root: Array


class Misfit:
    """The whitened misfit of `problem` at `x` without what another x would take of it.

    `left` (N + n) is it, with the priors' n rows at the end; `known` stands for them, if it is there. It is that of the
    free `runs` at `x`, or of others.
    """

    def __init__(
        self, problem: Problem, x: Array, weights: Sequence[Weigh], known: Known | None = None, runs: Runs | None = None
    ) -> None:
        free = np.abs(problem.bounds - x).min(axis=0) > AT_BOUND if known is None else known.free
        root, behind = (np.eye(int(free.sum())), -x[free]) if known is None else (known.root, np.zeros(len(known.root)))
        e = np.concatenate([white(part) for white, part in zip(weights, problem.left(x, runs), strict=True)])
        slopes = problem.slopes(x, runs)
        J = np.concatenate([white(-part[:, free]) for white, part in zip(weights, slopes, strict=True)])
        self._weights = weights
        self._Q = np.linalg.qr(np.concatenate([J, root]))[0]
        self.left = self._projected(np.concatenate([e, behind]))

    @property
    def square(self) -> float:
        """The square of what is left."""
        return float(self.left @ self.left)

    def response(self, by_section: Sequence[Array]) -> "Response":
        """The response to inputs with cells of their own in every section: columns (N, cells) by section."""
        parts = [white(part) for white, part in zip(self._weights, by_section, strict=True)]
        P = np.concatenate([q.T @ part for q, part in zip(self._rows(parts), parts, strict=True)], axis=1)
        own = block_diag(*(part.T @ part for part in parts))
        return Response(parts, P, own, own - P.T @ P, self.pull(parts, self.left))

    def pull(self, parts: Sequence[Array], left: Array) -> Array:
        """What of `left`, which is projected, falls on the columns."""
        return np.concatenate([part.T @ e for part, e in zip(parts, self._rows(parts, left), strict=True)])

    def shared(self, by_section: Sequence[Array]) -> Array:
        """Whitened, projected columns (N + n, D) of inputs that all sections share."""
        D = np.concatenate([white(part) for white, part in zip(self._weights, by_section, strict=True)])
        return self._projected(np.concatenate([D, np.zeros((self._Q.shape[1], D.shape[1]))]))

    def without(self, explained: Array) -> "Misfit":
        """The misfit less what something explains of it, whitened and projected (N + n)."""
        found = copy(self)
        found.left = self.left - explained
        return found

    def _rows(self, parts: Sequence[Array], values: Array | None = None) -> list[Array]:
        """The rows of values, or of Q, that belong to each section."""
        ends = np.cumsum([len(part) for part in parts])
        return np.split((self._Q if values is None else values)[: ends[-1]], ends[:-1])

    def _projected(self, values: Array) -> Array:
        return np.asarray(values - self._Q @ (self._Q.T @ values))

    def effect(self, response: "Response", amplitudes: Array) -> Array:
        """What the amplitudes do, whitened and projected (N + n)."""
        widths = np.cumsum([part.shape[1] for part in response.parts])[:-1]
        raw = [part @ a for part, a in zip(response.parts, np.split(amplitudes, widths), strict=True)]
        priors = np.zeros(self._Q.shape[1])
        return self._projected(np.concatenate([*raw, priors]))


@dataclass(frozen=True)
class Response:
    """Whitened columns by section, their part along dx (n, cells), their D'D, and of what is left D'D and D'e."""

    parts: Sequence[Array]
    along: Array
    own_gram: Array
    gram: Array
    pull: Array

    def times(self, factor: float) -> "Response":
        """To an input that is so much larger."""
        parts = [factor * part for part in self.parts]
        square = factor**2
        return Response(parts, factor * self.along, square * self.own_gram, square * self.gram, factor * self.pull)

    def cross(self, other: "Response") -> Array:
        """D'D_other of what is left."""
        own = block_diag(*(a.T @ b for a, b in zip(self.parts, other.parts, strict=True)))
        return np.asarray(own - self.along.T @ other.along)

    def beside(self, misfit: Misfit, columns: Array, sd: float) -> "Response":
        """The same, when whitened, projected `columns` with coefficients N(0, `sd`^2) may explain the data too."""
        root = np.linalg.cholesky(columns.T @ columns + np.eye(columns.shape[1]) / sd**2)
        further = np.linalg.solve(root, misfit.pull(self.parts, columns).T)
        along = np.concatenate([self.along, further])
        pull = self.pull - further.T @ np.linalg.solve(root, columns.T @ misfit.left)
        return replace(self, along=along, gram=self.gram - further.T @ further, pull=pull)

    def given(self, known: "Response", latent: "Latent") -> "Response":
        """The same, when the input of another equation has been taken for unknown too."""
        between = self.cross(known)
        gram = self.gram - between @ latent.covariance @ between.T
        return replace(self, gram=gram, pull=self.pull - between @ latent.mean)


class Latent:
    """Amplitudes a = R z sigma of a response, z unit normal: R is `root`."""

    def __init__(self, gram: Array, pull: Array, root: Array) -> None:
        self._root = root
        power, self._V = np.linalg.eigh(root.T @ gram @ root)
        self._power = np.maximum(power, 0.0)
        self._h = self._V.T @ (root.T @ pull)
        gains = gain(self._power, self._h[None] ** 2)[:, 0]
        best = int(np.argmax(gains))
        self.evidence = max(0.0, float(gains[best]))
        """Twice the gain of the log marginal likelihood at the best intensity."""
        self.sigma = float(SIGMAS[best]) if gains[best] > 0.0 else 0.0

    @property
    def scaled_root(self) -> Array:
        """A root of the amplitudes' covariance beforehand, at the best intensity."""
        return np.asarray(self._root * self.sigma)

    @cached_property
    def _share(self) -> Array:
        return np.asarray(self.sigma**2 / (1.0 + self.sigma**2 * self._power))

    @cached_property
    def mean(self) -> Array:
        """Of the amplitudes, given the data."""
        return np.asarray(self._root @ (self._V @ (self._share * self._h)))

    @cached_property
    def covariance(self) -> Array:
        """Of the amplitudes, given the data."""
        T = self._root @ self._V
        return np.asarray((T * self._share) @ T.T)


def gain(power: Array, squares: Array) -> Array:
    """Twice the gain of the log marginal likelihood for every of `SIGMAS` and every row of h^2 (draws, columns)."""
    s = SIGMAS[:, None] ** 2
    return np.asarray((s / (1.0 + s * power)) @ squares.T - np.log1p(s * power).sum(axis=1, keepdims=True))


def null_law(gram: Array, roots: Sequence[Array], draws: int, seed: int = 1) -> Array:
    """What the largest evidence of several priors is (draws,) when nothing is missing: a parametric bootstrap."""
    power, V = np.linalg.eigh(gram)
    z = np.random.default_rng(seed).standard_normal((draws, len(gram)))
    pulls = (z * np.sqrt(np.maximum(power, 0.0))) @ V.T
    found = np.zeros(draws)
    for root in roots:
        power, V = np.linalg.eigh(root.T @ gram @ root)
        gains = gain(np.maximum(power, 0.0), (pulls @ root @ V) ** 2)
        found = np.maximum(found, gains.max(axis=0))
    return found


def tail(law: Array, value: float) -> float:
    """The probability of more than `value`: counted, and beyond the largest tenth by an exponential tail."""
    start = float(np.quantile(law, 0.9))
    if value <= start:
        return float(np.mean(law >= value))
    beyond = law[law > start] - start
    return float(0.1 * np.exp(-(value - start) / beyond.mean()))
