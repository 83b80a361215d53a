"""The training: phases of ever longer windows, the best weights of every member's test kept."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from faultline.service.core.errors import InputError
from faultline.training.device import CPU
from faultline.training.free_run import free_run
from faultline.training.layout import Layout
from faultline.training.linear import linear_outputs, linear_rates
from faultline.training.network import SPEED, Networks
from faultline.training.recipe import Phase, Recipe
from faultline.training.reckoned import Equations, Example, reckoned
from faultline.training.rescaling import at_least, rescaled
from faultline.training.samples import Samples
from faultline.training.scaling import Scaling, scaling_of
from faultline.training.varied import varied
from faultline.training.windows import Batch, Windows

Array = npt.NDArray[np.float64]

EVERY = 50
"""Iterations between two looks at the free run."""

ROOM = 2.0
"""Ranges of a state in training by which it may leave that range: a fault does, and a network that runs away."""

EPSILON = 1e-8
"""Adam's, against division by zero."""


@dataclass
class History:
    """What a look at the free run saw: at `iteration`, the `loss` and each test's free-run `error`s, scaled.

    `seen` and `held` are medians over members (T,) where a member was trained, and in the fold that it did not see.
    """

    iteration: list[int] = field(default_factory=list)
    loss: list[float] = field(default_factory=list)
    seen: list[list[float]] = field(default_factory=list)
    held: list[list[float]] = field(default_factory=list)


@dataclass(frozen=True)
class Report:
    """To whoever watches: `done` of `of` iterations, the loss, the median free-run error over tests, what is kept."""

    done: int
    of: int
    loss: float
    error: float


class Begin(Protocol):
    """Weights that were trained before, and the scaling that they are for."""

    @property
    def weights(self) -> dict[str, Tensor]:
        """The networks' state."""

    @property
    def scaling(self) -> Scaling:
        """Of these weights."""


class Training:
    """A training with all that it takes to go on: weights, optimizer, random numbers, best weights, history.

    On a `device`; random numbers are the CPU's on any, and `windows` stay there.
    """

    def __init__(
        self,
        layout: Layout,
        samples: Samples,
        recipe: Recipe,
        seed: int,
        begin: "Begin | None" = None,
        device: torch.device = CPU,
        scaling: Scaling | None = None,
    ) -> None:
        torch.manual_seed(seed)
        if not recipe.moved:
            samples = replace(samples, stretches=tuple(s for s in samples.stretches if s.natural))
        equations = None if layout.model.without_formula else Equations(layout)
        examples = reckoned(layout, samples, equations)
        others = varied(layout, examples, equations, recipe.varied, recipe.copies, seed)
        if scaling is None:
            own = scaling_of(examples, recipe.scale)
            scaling = at_least(own, begin.scaling) if begin else own
        self.scaling = scaling
        self.layout, self.recipe = layout, recipe
        self.recordings = [stretch.recording for stretch in samples.stretches]
        self.stopped: str | None = None  # why, if it was before the end
        self.windows = Windows(layout, examples, others, scaling, recipe.folds, seed)
        self.networks = Networks(layout, recipe, recipe.members)
        if begin:
            self.networks.load_state_dict(rescaled(begin.weights, layout, recipe, begin.scaling, scaling))
        else:
            self._linear([*examples, *others])
            self.networks.bound(*_bounds([*examples, *others], scaling))
        self.networks.to(device)
        self._near, self._owner = self.windows.to(device), torch.as_tensor(layout.owner, device=device)
        fixed = () if self.networks.outputs.hidden else (self.networks.outputs.first,)  # h is a state: no gain to learn
        learns = [p for p in self.networks.parameters() if p.numel()]  # without states no function says how they move
        self._parameters = [p for p in learns if all(p is not other for other in fixed)]
        behind = {id(p) for p in self.networks.rates.weights}
        groups = [
            {"params": [p for p in self._parameters if (id(p) in behind) is chosen], "weight_decay": decay}
            for chosen, decay in ((True, recipe.decay), (False, 0.0))
        ]
        self._optimizer = torch.optim.AdamW(groups, lr=recipe.rate, eps=EPSILON)
        self._random = torch.Generator().manual_seed(seed)
        self._sensed = torch.tensor([float(name is not None) for name in layout.sensed], device=device)
        self.history = History()
        self.done = 0
        self.best = {name: value.clone() for name, value in self.networks.state_dict().items()}
        self.best_error = torch.full((recipe.members, len(layout.tests)), math.inf, device=device)
        if begin:  # as they are they may be best
            self._judge()

    @property
    def iterations(self) -> int:
        """Of all phases."""
        return sum(phase.iterations for phase in self.recipe.phases)

    def run(self, say: Callable[[Report], None], keep: Callable[[], None]) -> None:
        """To the end; `say` hears of every look at the free run, `keep` may write a checkpoint then.

        Raises:
            InputError: it diverges, and nothing good was found before.
        """
        while self.done < self.iterations:
            loss = float(self.step())
            self.done += 1
            if not math.isfinite(loss):
                self._stop(f"the loss is {loss}")
                return
            if self.done % EVERY == 0 or self.done == self.iterations:
                error = self._look(loss)
                say(Report(self.done, self.iterations, loss, error))
                keep()

    def finish(self) -> Networks:
        """The networks with the best weights of every member's test, on the CPU."""
        self.networks.load_state_dict(self.best)
        return self.networks.to(CPU)

    def state(self) -> dict[str, Any]:
        """All that `restore` needs."""
        return {
            "done": self.done,
            "weights": self.networks.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "random": self._random.get_state(),
            "best": self.best,
            "best_error": self.best_error,
            "history": vars(self.history),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Goes on where another one, of the same arguments, was when it gave its `state`."""
        self.done = state["done"]
        self.networks.load_state_dict(state["weights"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._random.set_state(state["random"])
        device = self.best_error.device
        self.best = {name: value.to(device) for name, value in state["best"].items()}
        self.best_error = state["best_error"].to(device)
        self.history = History(**state["history"])

    def _linear(self, examples: Sequence[Example]) -> None:
        """Begins with what least squares gives."""
        layout, networks = self.layout, self.networks
        share = 1.0 / (1.0 + math.exp(-SPEED))
        starts = [(networks.outputs, linear_outputs(layout, examples, self.scaling))]
        if self.recipe.linear:
            starts.append((networks.rates, linear_rates(layout, networks.columns, examples, self.scaling, share)))
        for stack, at in starts:
            parts = (torch.tensor(part, dtype=torch.float32) for part in at)
            stack.set_linear(*(part.expand(self.recipe.members, *part.shape) for part in parts))

    def _phase(self) -> Phase:
        before = 0
        for phase in self.recipe.phases:
            before += phase.iterations
            if self.done < before:
                return phase
        return self.recipe.phases[-1]

    def step(self) -> Tensor:
        """An iteration; returns its loss."""
        phase = self._phase()
        for group in self._optimizer.param_groups:
            group["lr"] = self._rate()
        batch = self._near.batch(phase, self.recipe, self._random)
        loss = self._loss(batch, phase.burn)
        self._optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self._clip()
        self._optimizer.step()
        return loss.detach()

    def _loss(self, batch: Batch, burn: int) -> Tensor:
        """The mean squared error of what the tests predict, summed over members and tests: each learns by itself."""
        run = self.networks.run(batch.x, batch.u)
        counts = batch.counts[burn:, :, None]
        weight = counts / counts.sum(dim=(0, 3), keepdim=True).clamp(min=1.0)
        loss = ((run.y[burn:] - batch.y[burn:]) ** 2 * weight).sum()
        if self.recipe.latent:
            wanted = self.recipe.latent * self._sensed[:, None]
            loss = loss + (wanted * (run.x[burn:] - batch.known[burn:]) ** 2 * weight).sum()
        return loss

    def _rate(self) -> float:
        recipe, done = self.recipe, self.done
        warm = min(1.0, (done + 1) / recipe.warm_up) if recipe.warm_up else 1.0
        if recipe.last is None:
            return float(recipe.rate * warm * 0.98 ** (done // 10))
        part = 0.5 * (1.0 + math.cos(math.pi * done / self.iterations))
        return recipe.rate * warm * (recipe.last + (1.0 - recipe.last) * part)

    def _clip(self) -> None:
        """Cuts the gradient of every member's test at the recipe's norm."""
        members = self.recipe.members
        square = torch.zeros_like(self.best_error)
        for parameter, test in self._owned():
            if parameter.grad is None:  # an increment has no speed to learn
                continue
            square.index_add_(1, test, parameter.grad.reshape(members, len(test), -1).pow(2).sum(dim=2))
        scale = (self.recipe.clip / square.sqrt().clamp(min=1e-12)).clamp(max=1.0)
        outputs = self.networks.outputs
        learnt = {id(p) for p in outputs.parameters() if p is not outputs.bias}
        for parameter, test in self._owned():
            if parameter.grad is None:
                continue
            grad = parameter.grad.view(members, len(test), -1).mul_(scale[:, test, None])
            if id(parameter) in learnt:  # where h is a state there is an offset to learn, and no more
                grad[:, self.networks.direct] = 0.0

    def _owned(self) -> list[tuple[Tensor, Tensor]]:
        """The parameters, each with the test of each of its functions."""
        tests = torch.arange(len(self.layout.tests), device=self._owner.device)
        outputs = {id(p) for p in self.networks.outputs.parameters()}
        return [(p, tests if id(p) in outputs else self._owner) for p in self._parameters]

    def take(self, other: "Training", clearly: float) -> list[str]:
        """Keeps tests that err less than `clearly` (a part of 1) times as much as another training's; takes the rest.

        Errors are those where the recording was held out, by all members together: what one held out is a fifth of it,
        all together are the whole. Returns the names of the tests that were taken.
        """
        own, others = (each.best_error.pow(2).mean(dim=0).sqrt() for each in (self, other))
        better = (own > clearly * others).expand(self.recipe.members, -1)
        self._keep(better, other.best)
        self.best_error = torch.where(better, other.best_error, self.best_error)
        return [test.name for test, taken in zip(self.layout.tests, better[0].tolist(), strict=True) if taken]

    def _look(self, loss: float) -> float:
        """Free run; keeps what is better than ever. The median error over members and tests where it was not seen."""
        seen, held, judged = self._judge()
        self.history.iteration.append(self.done)
        self.history.loss.append(loss)
        for kept, errors in ((self.history.seen, seen), (self.history.held, held)):
            kept.append(errors.cpu().median(dim=0).values.tolist())  # CUDA has no deterministic median
        return float(judged.cpu().median())

    def _judge(self) -> tuple[Tensor, Tensor, Tensor]:
        """Free-run errors (M, T) where a member was trained, where it was held out, and where it is judged."""
        near = self._near
        course = free_run(self.networks, near)
        y = near.y[course.at].T  # (T, K)
        square = (course.y - y).pow(2)
        hidden = (near.fold[course.at] == near.of(self.recipe.members)[:, None]).to(torch.float32)
        seen, held = (_rms(square, part[:, None]) for part in (1.0 - hidden, hidden))
        judged = torch.where(torch.isinf(held), seen, held)  # a fold may have no tick with a run-up
        better = judged < self.best_error if self.recipe.folds else torch.isfinite(judged)  # else the last ones stay
        self._keep(better, self.networks.state_dict())
        self.best_error = torch.where(better, judged, self.best_error)
        return seen, held, judged

    def _keep(self, better: Tensor, weights: Mapping[str, Tensor]) -> None:
        """Takes the `weights` of the members' tests (M, T) that are `better` than ever."""
        for name, now in weights.items():
            # of the functions that are a test's
            mask = better if name.startswith("outputs") else better[:, self._owner]
            if mask.numel():
                new, old = (value.reshape(*mask.shape, -1) for value in (now, self.best[name]))
                self.best[name] = torch.where(mask[:, :, None], new, old).reshape(now.shape)

    def _stop(self, why: str) -> None:
        self.stopped = f"it diverges, {why}"
        if not bool(torch.isfinite(self.best_error).all()):
            raise InputError(
                f"training diverges after {self.done} iterations ({why}), before every test had run freely once; train "
                "on more data, or with another --seed or --recipe"
            )


def _bounds(examples: Sequence[Example], scaling: Scaling) -> tuple[Array, Array]:
    """The lowest and highest scaled values (F,) of the states: those of the examples, and `ROOM` times their range."""
    x = scaling.x(np.concatenate([example.x for example in examples]))
    lowest, highest = x.min(axis=0), x.max(axis=0)
    room = ROOM * (highest - lowest)
    return lowest - room, highest + room


def _rms(square: Tensor, weight: Tensor) -> Tensor:
    """Root mean (M, T) of squares (M, T, K) where the weight is one; infinite where that is nowhere."""
    count = weight.sum(dim=2)
    mean = (square * weight).sum(dim=2) / count.clamp(min=1.0)
    return torch.where(count > 0, mean.sqrt(), torch.full_like(mean, math.inf))
