"""Which models can be run freely, and models whose form is unusual."""

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.model import Model, load_model
from faultline.analysis.model.file import parse_model
from faultline.analysis.simulation import Drive, Trajectory, run, system_of
from faultline.analysis.simulation.system import _function
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

T = np.arange(0.0, 10.0, 0.05)
U = np.sin(T)[:, None]

SIGNAL = 'unit = "1"\nmin = -10.0\nmax = 10.0\nnoise = 0.1\n'


def small(*equations: str, k: float = 0.5) -> Model:
    """A state x, another variable z, parameters k and g; u is the input and y is measured."""
    written = "".join(f'[[equation]]\nname = "e{n}"\nexpr = "{e}"\n' for n, e in enumerate(equations))
    return parse_model(
        f'schema = 1\nname = "small"\n[known.u]\n{SIGNAL}[known.y]\n{SIGNAL}'
        '[unknown.x]\nunit = "1"\ninitial = ["u"]\n[unknown.dx]\nunit = "1/s"\n[unknown.z]\nunit = "1"\n'
        f'[parameter.k]\nunit = "1"\nvalue = {k}\nprior = 0.5\n[parameter.g]\nunit = "1"\nvalue = 1.0\n'
        f'{written}[[differential]]\nname = "d"\nstate = "x"\nderivative = "dx"\n',
        "small.toml",
    )


def free_run(model: Model, k: float | None = None) -> Trajectory:
    system = system_of(model, ["k"])
    value = model.parameters["k"].value if k is None else k
    return run(system, Drive(0.05, U, np.zeros(1), np.zeros((len(T), 1))), {"k": value})


def lagged(rate: float) -> Array:
    """dx = rate (sin t - x) from 0."""
    return np.asarray(rate * (rate * np.sin(T) - np.cos(T) + np.exp(-rate * T)) / (1.0 + rate**2))


def test_a_lag_is_what_the_books_say() -> None:
    x = free_run(small("y - x", "z - x", "dx - k*(g*u - x)")).outputs()["y"]
    assert np.abs(x - lagged(0.5)).max() < 1e-3


def test_the_source_of_the_shipped_circuit_is_an_input() -> None:
    """Its loop, u - u_R - u_c, has a single known signal too, but two unknowns: no sensor."""
    system = system_of(load_model("rc"), ["R"])
    assert system.inputs == ("u",)
    assert list(system.outputs) == ["y_i"]


@pytest.mark.parametrize(
    ("equations", "count"),
    [(("y - x", "dx - k*(g*u - z)"), 1), (("y - x", "z - x", "z + k*x", "dx - k*(g*u - x)"), 3)],
    ids=["too few", "too many"],
)
def test_a_model_needs_as_many_equations_as_variables(equations: tuple[str, ...], count: int) -> None:
    with pytest.raises(
        InputError, match=rf"^small: {count} equations besides its sensors' \(y\) for 2 derivatives and"
    ):
        system_of(small(*equations), ["k"])


def test_what_the_equations_leave_open_is_named() -> None:
    """The second equation says the same as the first."""
    model = small("y - x", "dx + x - g*u + k*z", "k*dx + k*x - k*g*u + k*k*z")
    with pytest.raises(InputError, match=r"^small: the equations do not determine z; check them"):
        free_run(model)


def test_no_solution_is_an_error() -> None:
    model = small("y - z", "k*z**2 + z + 1.3 + x**2", "dx - k*(g*u - x)")
    with pytest.raises(InputError, match=r"^small: no free run is found; check the parameters and what the inputs do"):
        free_run(model)


@pytest.mark.parametrize("k", [1e-6, 1e-9, 1e6])
def test_the_sizes_of_variables_do_not_matter(k: float) -> None:
    """z is x/k and is first looked for at 0; areas and flows in SI units are such."""
    trajectory = free_run(small("y - z", "k*z - x", "dx - 0.5*(g*u - x)", k=k))
    assert np.abs(k * trajectory.outputs()["y"] - lagged(0.5))[1:].max() < 1e-3


def test_an_output_may_show_a_derivative() -> None:
    """y = k dx, as a current into a capacitor."""
    model = small("y - z", "k*dx - z", "dx - k*(g*u - x)")
    middle = free_run(model)
    up, down = (free_run(model, 0.5 + d).outputs()["y"] for d in (1e-4, -1e-4))
    assert np.abs(middle.by_parameters()["y"][:, 0] - (up - down) / 2e-4)[1:].max() < 1e-6
    bump = np.exp(-((T - 5.0) ** 2))[:, None]
    moved = run(middle.system, Drive(0.05, U + bump, np.zeros(1), middle.drive.guess), {"k": 0.5}).outputs()["y"]
    assert np.abs(middle.by_input("u", bump)["y"][:, 0] - (moved - middle.outputs()["y"]))[1:].max() < 1e-9


def test_an_output_may_show_a_root() -> None:
    model = small("y - z", "z - sgsqrt(x)", "dx - k*(g*u - x)")
    middle = free_run(model)
    x = middle.w[:, 0]
    assert np.abs(middle.outputs()["y"] - np.sign(x) * np.sqrt(np.abs(x))).max() < 1e-4
    up, down = (free_run(model, 0.5 + d).outputs()["y"] for d in (1e-5, -1e-5))
    clear = np.abs(x) > 0.1
    assert np.abs(middle.by_parameters()["y"][:, 0] - (up - down) / 2e-5)[clear].max() < 1e-6


def test_parameters_that_are_numbers_are_the_same_as_symbols() -> None:
    """Regression: with all of them numbers, rounding left a variable in its own substitution."""
    u = np.tile([25.0, 0.3], (100, 1))
    drive = Drive(0.05, u, np.array([9.9e5]), np.full((100, 1), 9.9e5))
    uds1 = load_model("uds/production")
    values = {name: p.value for name, p in uds1.parameters.items()}
    numbers = run(system_of(uds1, []), drive, {}).outputs()
    symbols = run(system_of(uds1, list(values)), drive, values).outputs()
    for name, y in symbols.items():
        assert np.abs(numbers[name] - y)[1:].max() < 1e-9 * np.abs(y).max(), name


def test_equations_that_another_model_has_too_are_compiled_once() -> None:
    model = load_model("uds")
    first = system_of(model, ["A_ori", "A_dos"])
    assert first.by_variable.shape == (len(first.residuals), len(first.variables))
    compiled = _function.cache_info().misses
    text = model.equations["e04"].text
    changed = dataclasses.replace(model.equations["e04"], text=text, expression=1.5 * model.equations["e04"].expression)
    other = system_of(dataclasses.replace(model, equations={**model.equations, "e04": changed}), ["A_ori", "A_dos"])
    assert other.by_variable.places == first.by_variable.places
    assert 1 <= _function.cache_info().misses - compiled <= 2
