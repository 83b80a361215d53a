"""Trucks beside the bench: a kind with longer hoses, and a fleet in which every one differs."""

import statistics

import pytest

from faultline.testbench.bus import Knowledge
from faultline.testbench.cycles import CYCLES, SYSTEM
from faultline.testbench.errors import RigError
from faultline.testbench.simulation import simulate
from faultline.testbench.vehicles import LIFE, VEHICLES, vehicle


def test_a_truck_has_longer_hoses_and_other_sensors() -> None:
    bench, truck = VEHICLES["bench"], VEHICLES["truck"]
    assert truck.plant.hose.rated > bench.plant.hose.rated
    assert truck.plant.tank_filter.drop(2e-6) > bench.plant.tank_filter.drop(2e-6)
    assert truck.external["y_p_ap"].zero_sd > bench.external["y_p_ap"].zero_sd


def test_the_fleet_scatters_and_ages_and_is_the_same_every_time() -> None:
    trucks = [vehicle(f"truck-{k}") for k in range(1, 201)]
    assert trucks[6] == vehicle("truck-7")
    assert len({truck.pump.displacement for truck in trucks}) == 200
    ages = [truck.scatter["age_h"] for truck in trucks]
    assert 0 <= min(ages) < 0.05 * LIFE
    assert 0.95 * LIFE < max(ages) <= LIFE
    old, young = ([t for t in trucks if (t.scatter["age_h"] > LIFE / 2) == aged] for aged in (True, False))
    for part, worse in (("leakage", 1), ("du_filter", -1), ("hose", -1)):
        difference = statistics.median(t.scatter[part] for t in old) - statistics.median(t.scatter[part] for t in young)
        assert difference * worse > 0
    displacement = [truck.scatter["displacement"] for truck in trucks]
    assert statistics.stdev(displacement) == pytest.approx(0.02, rel=0.2)


def test_every_truck_of_a_fleet_holds_its_pressure() -> None:
    for number in range(1, 6):
        run = simulate(vehicle(f"truck-{number}"), CYCLES["maximum"], (), seed=number, duration=90.0)
        late = run.ecu_t > 60.0
        assert run.ecu[late, Knowledge._fields.index("p_du")].mean() == pytest.approx(SYSTEM, abs=5e3)
        assert run.ecu[late, Knowledge._fields.index("n_p")].max() < 50.0
        assert run.ecu[late, Knowledge._fields.index("duty")].min() == 1.0


@pytest.mark.parametrize("name", ["lorry", "truck-", "truck-x", "truck-01", "bench-2"])
def test_an_unknown_vehicle_is_refused(name: str) -> None:
    with pytest.raises(RigError, match=f"there is no vehicle '{name}'; choose one of bench, truck, or a truck-1"):
        vehicle(name)
