"""The free run against scipy on the model written by hand, and its derivatives against differences."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import numpy.typing as npt
import pytest
from by_hand import Rates, on_lines, solved, three_tank, uds, uds1, uds1_flow, values_of

from faultline.analysis.model import load_model
from faultline.analysis.simulation import Drive, System, Trajectory, run, system_of

Array = npt.NDArray[np.float64]
ATMOSPHERE = 101325.0
BAR = 1e5

UDS4, UDS1, TANKS = (load_model(name) for name in ("uds", "uds/production", "three-tank"))
SETTLED4 = (0.99 * BAR, 0.97 * BAR, 10.0 * BAR, 9.95 * BAR)
LEVELS = (0.5, 0.35, 0.2)


def drive(u: Array, step_s: float, start: Sequence[float]) -> Drive:
    """The states are looked for first where they begin."""
    first = np.array(start)
    return Drive(step_s, u, first, np.tile(first, (len(u), 1)))


def free_run(model_run: tuple[System, Sequence[float]], u: Array, step_s: float) -> Trajectory:
    system, start = model_run
    return run(
        system, drive(u, step_s, start), {name: system.model.parameters[name].value for name in system.parameters}
    )


def pump_and_dose(t: Array) -> Array:
    """Smooth: what a step of the time leaves is the method's own error."""
    return np.column_stack([26.0 + 5.0 * np.sin(0.9 * t), 0.4 + 0.3 * np.sin(0.5 * t)])


def level_command(t: Array) -> Array:
    return 0.5 + 0.4 * np.sin(0.4 * t)[:, None]


@pytest.mark.parametrize(
    ("name", "start", "rates", "inputs"),
    [
        ("uds", SETTLED4, uds, pump_and_dose),
        ("uds/production", SETTLED4[3:], uds1, pump_and_dose),
        ("three-tank", LEVELS, three_tank, level_command),
    ],
)
def test_the_error_shrinks_with_the_square_of_the_step(
    name: str, start: Sequence[float], rates: Rates, inputs: Callable[[Array], Array]
) -> None:
    """BDF2: halving the step takes three quarters of the error away; the start, which no sensor has, is left out."""
    model = load_model(name)
    system = system_of(model, [])
    fine = 0.00625
    t = np.arange(0.0, 20.0, fine)
    reference = solved(rates, np.array(start), t, lambda now: inputs(np.array([now]))[0], values_of(model), max(start))
    errors = []
    for factor in (8, 4, 2):
        instants = t[::factor]
        found = free_run((system, start), inputs(instants), fine * factor).w[:, : len(start)]
        errors.append(np.abs(found - reference[::factor])[instants > 5.0].max(axis=0))
    for coarse, half in ((errors[0], errors[1]), (errors[1], errors[2])):
        assert (coarse / half > 3.5).all(), (coarse, half)
        assert (coarse / half < 4.5).all(), (coarse, half)
    assert (errors[0] < 2e-4 * np.array(start)).all(), errors[0]  # at the step that calibration takes


@pytest.mark.parametrize(
    ("name", "start", "rates"),
    [("uds", SETTLED4, uds), ("uds/production", SETTLED4[3:], uds1)],
    ids=["uds", "uds/production"],
)
def test_dose_steps_and_a_pump_that_stops(name: str, start: Sequence[float], rates: Rates) -> None:
    """Without the pump its leak runs backwards through the filters, and e02 divides by its speed."""
    model = load_model(name)
    t = np.arange(0.0, 60.0, 0.05)
    n_p = np.interp(t, [0, 20, 21, 35, 36, 60], [25, 25, 0, 0, 30, 30])
    dose = np.interp(t, [0, 5, 5.2, 15, 15.2, 45, 45.2, 60], [0, 0, 0.7, 0.7, 0, 0, 1, 1])
    u = np.column_stack([n_p, dose])
    reference = solved(rates, np.array(start), t, on_lines(t, u), values_of(model), BAR)
    trajectory = free_run((system_of(model, []), start), u, 0.05)
    error = np.abs(trajectory.w[:, : len(start)] - reference)
    assert error.max() < 0.015 * BAR, error.max(axis=0)  # where a ramp of four steps begins or ends, at 17 bar
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.0015 * BAR
    if name == "uds":
        assert reference[:, 0].max() > ATMOSPHERE  # it did turn
    else:
        assert trajectory.outputs()["y_p_tp"][400:700].max() <= ATMOSPHERE  # the thesis's square knows no direction


def test_the_laminar_part_of_an_orifice_is_nothing_that_a_sensor_sees() -> None:
    t = np.arange(0.0, 10.0, 0.05)
    u = pump_and_dose(t)
    rough = partial(uds, laminar=1e-12)
    reference = solved(rough, np.array(SETTLED4), t, on_lines(t, u), values_of(UDS4), BAR)
    with_laminar = solved(uds, np.array(SETTLED4), t, on_lines(t, u), values_of(UDS4), BAR)
    assert np.abs(reference - with_laminar).max() < 10.0  # Pa; the best sensor's noise is 400


def test_pipes_between_tanks_flow_both_ways() -> None:
    t = np.arange(0.0, 60.0, 0.05)
    u = np.interp(t, [0, 25, 26, 60], [0.0, 0.0, 1.0, 1.0])[:, None]
    start = (0.2, 0.5, 0.1)
    reference = solved(three_tank, np.array(start), t, on_lines(t, u), values_of(TANKS), 1.0)
    between = reference[:, 0] - reference[:, 1]
    assert between.min() < -0.01  # backwards, then forwards
    assert between.max() > 0.01
    found = free_run((system_of(TANKS, []), start), u, 0.05).w[:, :3]
    assert np.abs(found - reference).max() < 1e-3


def test_all_at_rest_stays_at_rest() -> None:
    rest = (ATMOSPHERE,) * 4
    at_rest = free_run((system_of(UDS4, []), rest), np.zeros((200, 2)), 0.05)
    assert np.abs(at_rest.w[:, :4] - ATMOSPHERE).max() < 1e-3
    empty = free_run((system_of(TANKS, []), (0.0, 0.0, 0.0)), np.zeros((200, 1)), 0.05)
    assert np.abs(empty.w).max() < 1e-9


def test_the_outputs_of_one_state_follow_the_flow() -> None:
    """(4.18)-(4.20) with the flow solved by hand; at instant 0 only the state is known."""
    t = np.arange(0.0, 5.0, 0.05)
    u = pump_and_dose(t)
    trajectory = free_run((system_of(UDS1, []), SETTLED4[3:]), u, 0.05)
    p, outputs = values_of(UDS1), trajectory.outputs()
    q = np.array([uds1_flow(p_du, n_p, p) for p_du, n_p in zip(outputs["y_p_du"], u[:, 0], strict=True)])
    tank = p["p_tank"] - p["rho"] / 2.0 * (q / (p["C_q"] * p["A_t"])) ** 2
    after = outputs["y_p_du"] + p["rho"] / 2.0 * (q / (p["C_q"] * p["A_du"])) ** 2
    assert np.abs(outputs["y_p_tp"] - tank)[1:].max() < 1e-3
    assert np.abs(outputs["y_p_ap"] - after)[1:].max() < 1e-3


def test_one_state_and_four_agree_to_some_millibar() -> None:
    """The same parameters: the hose of one is what the other has before the dosing unit."""
    t = np.arange(0.0, 60.0, 0.05)
    u = np.column_stack(
        [np.interp(t, [0, 40, 42, 60], [25, 25, 30, 30]), np.interp(t, [0, 20, 20.2, 60], [0, 0, 0.6, 0.6])]
    )
    four = free_run((system_of(UDS4, []), SETTLED4), u, 0.05).outputs()
    one = free_run((system_of(UDS1, []), SETTLED4[3:]), u, 0.05).outputs()
    for name, millibar in (("y_p_tp", 0.5), ("y_p_ap", 30.0), ("y_p_du", 30.0)):
        apart = np.abs(four[name] - one[name])
        assert apart[t > 1.0].max() < millibar * 100.0, name
        assert apart[(t > 55.0) | ((t > 15.0) & (t < 20.0))].max() < 0.1 * millibar * 100.0, name


DRIVES: dict[str, tuple[Sequence[float], Callable[[Array], Array]]] = {
    "uds": (SETTLED4, lambda t: pump_and_dose(t) * np.column_stack([abs(t - 12.7) > 0.7, np.ones_like(t)])),
    "uds/production": (SETTLED4[3:], pump_and_dose),
    "three-tank": ((0.2, 0.5, 0.1), level_command),
}


def assert_same(exact: Array, up: Array, down: Array) -> None:
    """The change that the derivative says is half of what lies between; what rounding leaves is no difference."""
    difference = (up - down)[1:] / 2.0
    error = np.abs(exact[1:] - difference).max()
    assert error <= 1e-5 * np.abs(difference).max() + 1e-9 * np.abs(up).max(), error


@pytest.mark.parametrize("name", list(DRIVES))
def test_derivatives_to_every_parameter_are_exact(name: str) -> None:
    """With the pump stopped for a while where it may."""
    model = load_model(name)
    free = model.calibrated
    system = system_of(model, free)
    start, inputs = DRIVES[name]
    u = inputs(np.arange(0.0, 20.0, 0.05))
    values = {parameter: model.parameters[parameter].value for parameter in free}
    middle = run(system, drive(u, 0.05, start), values)
    exact = middle.by_parameters()
    for k, parameter in enumerate(free):
        step = 1e-4 * values[parameter]
        up, down = (
            run(system, drive(u, 0.05, start), {**values, parameter: values[parameter] + d}).outputs()
            for d in (step, -step)
        )
        for y in system.outputs:
            assert_same(step * exact[y][:, k], up[y], down[y])


@pytest.mark.parametrize("name", list(DRIVES))
def test_derivatives_to_disturbances_of_an_input_are_exact(name: str) -> None:
    model = load_model(name)
    system = system_of(model, [])
    start, inputs = DRIVES[name]
    t = np.arange(0.0, 20.0, 0.05)
    u = inputs(t)
    middle = free_run((system, start), u, 0.05)
    for k, signal in enumerate(system.inputs):
        size = 1e-4 * np.abs(u[:, k]).max()
        directions = size * np.column_stack([np.exp(-((t - 8.0) ** 2)), (t > 13.0) & (t < 15.0)])
        exact = middle.by_input(signal, directions)
        for d in range(2):
            moved = [u.copy(), u.copy()]
            moved[0][:, k] += directions[:, d]
            moved[1][:, k] -= directions[:, d]
            up, down = (free_run((system, start), v, 0.05).outputs() for v in moved)
            for y in system.outputs:
                assert_same(exact[y][:, d], up[y], down[y])


def test_a_run_near_another_is_the_same() -> None:
    start, inputs = DRIVES["uds"]
    system = system_of(UDS4, ["D_p"])
    u = inputs(np.arange(0.0, 20.0, 0.05))
    other = run(system, drive(u, 0.05, start), {"D_p": 0.9e-7})
    alone = run(system, drive(u, 0.05, start), {"D_p": 1e-7})
    near = run(system, drive(u, 0.05, start), {"D_p": 1e-7}, other)
    assert np.abs(near.w - alone.w).max() < 1e-6 * np.abs(alone.w).max()


def test_nothing_to_derive_to_is_no_columns() -> None:
    """Regression: given none, LAPACK's routine wrote into memory that is not its own."""
    start, inputs = DRIVES["uds"]
    u = inputs(np.arange(0.0, 5.0, 0.05))
    trajectory = free_run((system_of(UDS4, []), start), u, 0.05)
    for found in (trajectory.by_parameters(), trajectory.by_input("n_p", np.zeros((len(u), 0)))):
        assert {y.shape for y in found.values()} == {(len(u), 0)}
