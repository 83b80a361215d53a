"""The hypotheses say what the residuals do under a fault; known faults are asked for by sign, size and place."""

from dataclasses import dataclass, replace

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.graph.bank import Bank, build_bank
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import Model, load_model
from faultline.analysis.tuning.baselines import without_baseline
from faultline.analysis.tuning.evidence import gather
from faultline.analysis.tuning.moves import Moves
from faultline.analysis.tuning.straying import as_seen, doubted
from faultline.analysis.tuning.thresholds import Seen, tune_detectors
from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel
from faultline.service.core.decision.baseline_level import BaselineLevel
from faultline.service.core.decision.blocks import BlockMeans
from faultline.service.core.decision.decision import CONFIRMED
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.look import TIE, Look
from faultline.service.core.decision.window import Window
from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import TimeScale

IDLE, PARTIAL, MAXIMUM = 1, 2, 3  # indices of the dosing system's modes, behind the edge
MODES, TIME = ("edge", "idle", "partial", "maximum"), TimeScale(0.2, 20.0)  # of the dosing system
OWN = (0, 1, 2, 3)


Array = npt.NDArray[np.float64]

TICKS = 200
STEADY = (IDLE, PARTIAL, MAXIMUM)
LEVELS = {EDGE: (20.0, 0.2), IDLE: (20.0, 0.0), PARTIAL: (24.0, 0.4), MAXIMUM: (28.0, 1.0)}


def plant(bank: Bank, seed: int, fault: dict[str, float]) -> Array:
    """Samples (K, nz) of the model itself with sensor noise; t19, t20 and t21 use no sensor but their own."""
    names = [test.name for test in bank.tests]
    whole = bank.only([names.index(name) for name in ("t20", "t19", "t21")])
    z = np.zeros((TICKS * len(LEVELS), 5))
    z[:, 3:] = np.repeat(list(LEVELS.values()), TICKS, axis=0)
    z[:, :3] = -whole.simulate([fault], z, whole.start(np.array([101325.0] * 3 + [0.0, 0.0])))[:, 0]
    z[:, :3] += np.random.default_rng(seed).normal(0.0, [400.0, 800.0, 1000.0], (len(z), 3))
    return z


def watched(bank: Bank, seed: int, fault: dict[str, float] | None = None) -> Seen:
    z = plant(bank, seed, fault or {})
    r = bank.simulate([{}], z, bank.start(z[0]))[:, 0]
    mode = np.repeat(list(LEVELS), TICKS)
    mode[np.arange(len(z)) % TICKS < 20] = EDGE
    usable = np.repeat((np.arange(len(z)) >= 20)[:, None], len(bank.tests), axis=1)
    return Seen(f"made-{seed}", z, r, usable, mode, MODES, TIME)


def without_drifts(model: Model) -> Model:
    """The model, where nothing changes from one day to the next."""
    known = {name: replace(each, drift=0.0) for name, each in model.known.items()}
    parameters = {name: replace(each, drift=0.0) for name, each in model.parameters.items()}
    return replace(model, known=known, parameters=parameters)


@dataclass(frozen=True)
class Made:
    bank: Bank
    offset: Array
    recordings: list[Seen]
    evidence: Evidence

    def shift(self, fault: str, size: float) -> Array:
        """(mode, generator), on the first recording."""
        simple = self.evidence.hypotheses[: self.evidence.simple]
        [row] = [k for k, h in enumerate(simple) if (h.fault, h.size) == (fault, size)]
        one = self.recordings[0]
        shifts = self.shifts(one)[:, row]
        return np.array(
            [shifts[one.usable.all(axis=1) & (one.mode == mode)].mean(axis=0) for mode in range(len(MODES))]
        )

    def shifts(self, seen: Seen) -> Array:
        """What every hypothesis does at every tick (tick, hypothesis, generator), as the vehicle computes it."""
        evidence, runnable = self.evidence, Runnable(self.bank)
        generators = runnable.fresh(evidence)
        usable = np.ones(len(self.bank.inputs), dtype=np.bool_)
        return np.array([generators.step(z, usable).shift for z in seen.z])

    def look(self, seen: Seen) -> Look:
        """At the whole recording."""
        names = [g.name for g in self.bank.generators]
        columns = [names.index(name) for name in self.evidence.generators]
        window = Window(self.evidence, names, TIME)
        for mode, r, usable, shift in zip(seen.mode, seen.r, seen.usable, self.shifts(seen), strict=True):
            usual = np.zeros(len(r))
            usual[columns] = np.array(self.evidence.operation)[mode]
            nothing = np.zeros(len(self.evidence.consequences), dtype=np.bool_)
            window.add(int(mode), Residuals(r, usual, r, usable, shift, nothing))
        found = Hypotheses(self.evidence).look(window.means)
        assert found is not None
        return found

    def column(self, test: str) -> int:
        return self.evidence.generators.index(f"{test}.ode")


@pytest.fixture(scope="module")
def made() -> Made:
    bank = build_bank(without_drifts(load_model("uds")))
    recordings = [watched(bank, 1), watched(bank, 2)]
    offset = np.array(
        [d.offset for d in tune_detectors([g.name for g in bank.generators], recordings, bank.sigma, OWN)]
    )
    return Made(bank, offset, recordings, gather(bank, offset, recordings, OWN)[0])


def test_recordings_side_by_side_move_as_each_alone(made: Made) -> None:
    one, other = made.recordings
    half = len(other.z) // 2
    shorter = replace(other, z=other.z[:half], r=other.r[:half], usable=other.usable[:half], mode=other.mode[:half])
    trials, steps = [{"fA_t": -0.5}, {}], np.array([[0.0] * 5, [1000.0, 0.0, 0.0, 0.0, 0.0]])
    together = Moves().of(made.bank, [one, shorter], trials, steps)
    alone = [Moves().of(made.bank, [each], trials, steps)[0] for each in (one, shorter)]
    for of_both, of_one in zip(together, alone, strict=True):
        assert of_both.keys() == of_one.keys()
        for mode, moved in of_one.items():
            np.testing.assert_allclose(of_both[mode], moved, rtol=1e-9, atol=1e-3)


def test_the_baseline_is_taken_off_as_tick_by_tick(made: Made) -> None:
    one = made.recordings[0]
    there = np.arange(len(one.z)) % 97 != 0  # some ticks are missing
    number = np.flatnonzero(there)
    some = replace(one, z=one.z[there], r=one.r[there], usable=one.usable[there], mode=one.mode[there], number=number)
    names = [each.name for each in made.bank.generators]
    evidence = msgspec.structs.replace(made.evidence, graph=None, hypotheses=[])
    model = BaselineModel(evidence, TIME)
    baseline, blocks = BaselineFilter(model), BlockMeans(evidence, names, TIME)
    for tick, mode, r, usable in zip(number.tolist(), some.mode.tolist(), some.r, some.usable, strict=True):
        if (block := blocks.add(tick, mode, Residuals(r, r, r, usable))) is not None:
            baseline.step(block)
    known = BaselineLevel(evidence, names, model)
    known.follow(baseline.state)
    expected = [known.taken_off(mode, r) for mode, r in zip(some.mode.tolist(), some.r, strict=True)]
    level = without_baseline(some, made.evidence, names).level
    assert level is not None
    np.testing.assert_allclose(level, expected, rtol=1e-12, atol=1e-9)
    assert np.abs(level - some.r).max() > 1.0


def test_every_fault_and_size_of_the_model_has_its_hypothesis(made: Made) -> None:
    assumable = made.bank.model.assumable.values()
    sizes = {(fault.name, size, None) for fault in assumable for size in fault.sizes}
    shares = {(fault.name, share, fault.share_of) for fault in assumable for share in fault.shares}
    simple = made.evidence.hypotheses[: made.evidence.simple]
    found = [(h.fault, h.size, h.share_of) for h in simple]
    assert ({*found}, len(found)) == (sizes | shares, len(sizes) + len(shares))
    behind = [h for h in made.evidence.hypotheses if h.brought is not None]
    filters = {"fA_t", "fA_p", "fA_du"}
    assert {h.fault for h in behind} == filters | {"fy_p_du"}
    assert {h.size for h in behind if h.fault in filters} == {-0.8, -0.92, -0.97}  # the larger half of the sizes
    assert {h.size for h in behind if h.fault not in filters} == {-5e5, -3e5}  # as the model says
    assert len(simple) + len(behind) == len(made.evidence.hypotheses)
    shape = (len(MODES), len(made.evidence.generators))
    assert np.shape(made.evidence.offset) == np.shape(made.evidence.allowance) == shape


def test_the_smallest_of_each_form_of_a_fault_has_its_shift_in_usual_operation(made: Made) -> None:
    simple = made.evidence.hypotheses[: made.evidence.simple]
    assert {(h.fault, h.share_of) for h in simple if h.usual} == {(h.fault, h.share_of) for h in simple}
    assert all(abs(h.size) <= abs(other.size) for h in simple if h.usual for other in simple if other.fault == h.fault
               and other.share_of == h.share_of)  # fmt: skip
    shifts = np.concatenate([made.shifts(one) for one in made.recordings])
    steady = np.concatenate([np.where(one.usable.all(axis=1), one.mode, -1) for one in made.recordings])
    for row, h in enumerate(simple):
        for mode in STEADY if h.usual else ():
            expected = shifts[steady == mode, row].mean(axis=0)
            np.testing.assert_allclose(np.array(h.usual)[mode], expected, rtol=1e-6, atol=1e-3)


def test_a_clogged_filter_leaves_less_pressure_behind_it_the_more_the_worse(made: Made) -> None:
    """y_p_du of t02, computed from y_p_ap through the filter: measured below predicted."""
    column = made.column("t02")
    sizes = made.bank.model.faults["fA_du"].sizes
    shifts = np.array([made.shift("fA_du", size)[list(STEADY), column] for size in sizes])
    assert (shifts < 0).all()
    assert (np.diff(shifts, axis=0) < 0).all()


@pytest.mark.parametrize(("fault", "test"), [("fy_p_du", "t02"), ("fy_p_tp", "t08")])
@pytest.mark.parametrize("which", [0, -1])
def test_an_offset_sensor_shifts_the_test_that_predicts_it_by_its_offset(
    made: Made, fault: str, test: str, which: int
) -> None:
    size = made.bank.model.faults[fault].sizes[which]
    np.testing.assert_allclose(made.shift(fault, size)[:, made.column(test)], size, rtol=1e-9)


def test_a_test_that_does_not_see_a_fault_does_not_move(made: Made) -> None:
    shifts = made.shifts(made.recordings[0])
    disturbed = {e.disturbance.name: e.name for e in made.bank.model.equations.values() if e.disturbance}
    assert disturbed == {"fq_leak": "e10"}
    for row, hypothesis in enumerate(made.evidence.hypotheses[: made.evidence.simple]):
        for column, name in enumerate(made.evidence.generators):
            [generator] = [g for g in made.bank.generators if g.name == name]
            if hypothesis.fault not in generator.faults and disturbed.get(hypothesis.fault) not in generator.equations:
                assert np.abs(shifts[:, row, column]).max() < 1e-6, (hypothesis.fault, name)


def test_a_share_of_the_pumps_flow_is_lost_as_a_smaller_setting_loses_it(made: Made) -> None:
    """The second form of `fq_pump`: half the setting, so half the flow, whatever the speed."""
    row = [(h.fault, h.size, h.share_of) for h in made.evidence.hypotheses].index(("fq_pump", -0.5, "eps_p"))
    one, rows = made.recordings[0], [g.name for g in made.bank.generators]
    columns = [rows.index(name) for name in made.evidence.generators]
    value = made.bank.model.parameters["eps_p"].value
    r = made.bank.simulate([{}, {"eps_p": 0.5 * value}], one.z, made.bank.start(one.z[0]))[:, :, columns]
    np.testing.assert_allclose(made.shifts(one)[-1, row], (r[:, 0] - r[:, 1])[-1], rtol=1e-3, atol=1.0)


def test_a_filter_that_is_all_but_shut_takes_of_the_pumps_flow_as_well(made: Made) -> None:
    """A fault with its consequence: both parameters differ at once, which is no sum of two shifts."""
    row = [(h.fault, h.size, h.brought) for h in made.evidence.hypotheses].index(("fA_t", -0.8, -0.5))
    one, rows = made.recordings[0], [g.name for g in made.bank.generators]
    columns = [rows.index(name) for name in made.evidence.generators]
    model = made.bank.model
    both = {"fA_t": model.faults["fA_t"].absolute(-0.8, model), "eps_p": 0.5 * model.parameters["eps_p"].value}
    r = made.bank.simulate([{}, both], one.z, made.bank.start(one.z[0]))[:, :, columns]
    np.testing.assert_allclose(made.shifts(one)[-1, row], (r[:, 0] - r[:, 1])[-1], rtol=1e-3, atol=1.0)


def test_the_shift_is_what_the_faulty_vehicle_shows(made: Made) -> None:
    """The model with the fault, run as a vehicle, against the hypothesis, which has seen no faulty sample."""
    fault = made.bank.model.faults["fA_du"]
    faulty = watched(made.bank, 3, {"fA_du": fault.absolute(-0.6, made.bank.model)})
    column = made.column("t02")
    [row] = [k for k, g in enumerate(made.bank.generators) if g.name == "t02.ode"]
    for mode in STEADY:
        moved = faulty.r[faulty.mode == mode, row].mean() - np.array(made.evidence.offset)[mode, column]
        np.testing.assert_allclose(moved, made.shift("fA_du", -0.6)[mode, column], rtol=0.15, atol=150.0)


@pytest.mark.parametrize(("name", "size"), [("fA_du", -0.6), ("fA_ori", -0.05), ("fA_t", -0.6)])
def test_the_true_fault_fits_best(made: Made, name: str, size: float) -> None:
    fault = made.bank.model.faults[name]
    faulty = watched(made.bank, 4, {name: fault.absolute(size, made.bank.model)})
    look = made.look(faulty)
    assert min(look.faults, key=look.faults.__getitem__) == name
    assert look.faults[name] < look.limit
    assert look.faults[name] + TIE < min(q for fault, q in look.faults.items() if fault != name)


def test_without_a_fault_no_hypothesis_fits_much_better_than_none(made: Made) -> None:
    assert made.look(watched(made.bank, 5)).gain < CONFIRMED


@pytest.mark.parametrize("names", [("fA_du", "fq_pump"), ("fA_t", "fA_ori")])
def test_two_faults_at_once_fit_as_such_and_no_single_one_does(made: Made, names: tuple[str, str]) -> None:
    sizes = {"fA_du": -0.5, "fA_t": -0.5, "fA_ori": -0.1, "fq_pump": -2e-7}
    both = {name: made.bank.model.faults[name].absolute(sizes[name], made.bank.model) for name in names}
    look = made.look(watched(made.bank, 7, both))
    assert min(look.faults.values()) > look.limit
    fitting = [set(pair) for pair, q in look.pairs.items() if q < look.limit]
    assert set(names) in fitting


def test_a_visit_of_its_own_level_is_no_independent_evidence(made: Made) -> None:
    """Visits whose level strays by 1 kPa: tuning finds an upper bound, and a longer visit does not get surer."""
    rng = np.random.default_rng(6)
    strayed = []
    for one in made.recordings:
        z, r, usable, mode = (np.concatenate([part] * 10) for part in (one.z, one.r, one.usable, one.mode))
        s = Seen(one.name, z, r, usable, mode, MODES, TIME)
        r = s.r.copy()
        for start in range(0, len(r), 40):
            r[start : start + 40] += rng.normal(0.0, 1e3)
        mode = s.mode.copy()
        mode[::40] = EDGE  # every level is a visit
        strayed.append(replace(s, r=r, mode=mode))
    evidence, _ = gather(made.bank, made.offset, strayed, OWN)
    column = evidence.generators.index("t02.ode")
    for visit in np.array(evidence.visit)[list(STEADY)]:
        assert 1e3 < np.sqrt(visit[column, column]) < 1.8e3
        assert np.linalg.eigvalsh(visit).min() > -1e-6


def test_few_calm_visits_do_not_make_a_mode_calm(made: Made) -> None:
    """Visits stray by 1 kPa, but for two of each drive to one mode: the backlash of a sensor is the same in all."""
    rng = np.random.default_rng(6)
    strayed = []
    for one in made.recordings:
        z, r, usable, mode = (np.concatenate([part] * 10) for part in (one.z, one.r, one.usable, one.mode))
        r, mode = r.copy(), mode.copy()
        calm = np.flatnonzero(mode == MAXIMUM)
        for start in range(0, len(r), 40):
            r[start : start + 40] += 0.0 if mode[start + 20] == MAXIMUM else rng.normal(0.0, 1e3)
        mode[::40] = EDGE
        mode[calm[calm >= 2 * TICKS * len(LEVELS)]] = EDGE
        strayed.append(Seen(one.name, z, r, usable, mode, MODES, TIME))
    evidence, _ = gather(made.bank, made.offset, strayed, OWN)
    column = evidence.generators.index("t02.ode")
    idle, partial, maximum = np.sqrt(np.array(evidence.visit)[list(STEADY), column, column])
    assert maximum > 0.6 * min(idle, partial)


def test_a_drift_of_the_model_is_a_shift_that_all_means_share(made: Made) -> None:
    """A sensor's is its own in the test that predicts it; a parameter's has the pattern of that parameter's fault."""
    assert made.evidence.drifts == []
    model = made.bank.model
    known = {**model.known, "y_p_du": replace(model.known["y_p_du"], drift=300.0)}
    parameters = {**model.parameters, "A_du": replace(model.parameters["A_du"], drift=0.15)}
    bank = build_bank(replace(model, known=known, parameters=parameters))
    area, sensor = np.array(gather(bank, made.offset, made.recordings, OWN)[0].drifts)
    column = made.column("t02")
    np.testing.assert_allclose(sensor[:, column], 300.0, rtol=1e-9)
    clogged = made.shift("fA_du", -0.15)[list(STEADY), column]
    np.testing.assert_allclose(area[list(STEADY), column], clogged, rtol=0.4)


def test_ranking_looks_at_independent_generators_with_proper_covariances(made: Made) -> None:
    assert made.evidence.generators[0] == "t02.ode"
    assert 2 <= len(made.evidence.generators) < len(made.bank.generators)
    for noise in np.array(made.evidence.noise):
        np.testing.assert_allclose(noise, noise.T)
        assert np.linalg.eigvalsh(noise).min() > 0


def test_the_allowance_is_never_below_its_part_of_the_spread(made: Made) -> None:
    assert (np.array(made.evidence.allowance) >= 0.3 * np.array(made.evidence.spread)).all()


def test_the_same_recordings_give_the_same_evidence(made: Made) -> None:
    assert gather(made.bank, made.offset, made.recordings, OWN)[0] == made.evidence


def test_how_all_means_stray_together_is_seen_in_many_drives(made: Made) -> None:
    """Drives in which the sensor before the dosing unit is off by 500 Pa or so: t02 strays in all modes alike."""
    rng = np.random.default_rng(8)
    [row] = [k for k, g in enumerate(made.bank.generators) if g.name == "t02.ode"]
    drives = []
    for number in range(24):
        one = made.recordings[number % 2]
        r = one.r.copy()
        r[:, row] += rng.normal(0.0, 500.0)
        drives.append(replace(one, name=f"drive-{number}", r=r))
    evidence, _ = gather(made.bank, made.offset, drives, OWN)
    column = evidence.generators.index("t02.ode")
    first = np.array(evidence.drifts[0])[list(STEADY)] / doubted(23.0)
    assert np.abs(first[:, column]) == pytest.approx(500.0, rel=0.35)
    assert np.ptp(first[:, column]) < 150.0  # of one sign, and of one size
    others = [k for k in range(len(evidence.generators)) if k != column]
    assert np.abs(first[:, others]).max() < 100.0
    few, _ = gather(made.bank, made.offset, drives[:4], OWN)
    assert few.drifts == []
    assert np.array(few.allowance)[STEADY[0], column] > np.array(evidence.allowance)[STEADY[0], column]


def test_drifts_that_the_model_names_have_the_size_that_drives_show() -> None:
    """Two that overlap: one half as large as the model says, one not there at all; and what is each mean's own."""
    rng = np.random.default_rng(9)
    spread = np.full((len(MODES), 2), 100.0)
    drifts = np.zeros((2, len(MODES), 2))
    drifts[0, 1:] = [[200.0, -200.0]]
    drifts[1, 1:] = [[300.0, 0.0], [200.0, 0.0], [100.0, 0.0]]
    means = 0.5 * rng.standard_normal((200, 1, 1, 1))[:, 0] * drifts[0] + 20.0 * rng.standard_normal(
        (200, *spread.shape)
    )
    own, found, size = as_seen(means, spread, drifts, 2)
    assert found[:2] == pytest.approx(size[:, None, None] * drifts)
    assert size == pytest.approx([0.5, 0.0], abs=0.1)
    strayed = np.sqrt(own**2 + (found**2).sum(axis=0))[1:]
    assert strayed == pytest.approx(np.sqrt(20.0**2 + (0.5 * drifts[0]) ** 2)[1:], rel=0.15)


def test_generators_that_are_no_evidence_move_with_the_drifts_of_those_that_are() -> None:
    """One that the model names, and one that only the drives show."""
    rng = np.random.default_rng(10)
    spread, (x, u) = np.full((len(MODES), 3), 100.0), rng.standard_normal((2, 200, 1))
    drifts = np.zeros((1, len(MODES), 3))
    drifts[0, 1:] = [100.0, -100.0, 300.0]
    means = np.zeros((200, *spread.shape))
    means[:, 1:] = x[:, None] * [100.0, -100.0, 300.0] + u[:, None] * [200.0, 200.0, -400.0]
    means[..., :2] += 5.0 * rng.standard_normal((200, len(MODES), 2))
    own, found, _ = as_seen(means, spread, drifts, 2)
    assert own.shape == (len(MODES), 2)
    told = np.einsum("kmt,kms->mts", found, found)[1:]  # of modes, the covariance that drifts make of generators
    wanted = np.cov(means[:, 1].T, bias=True)
    assert told == pytest.approx(np.broadcast_to(wanted, told.shape), rel=0.15, abs=2000.0)
