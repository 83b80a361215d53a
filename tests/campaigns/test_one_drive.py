"""The pages of two campaigns count what their records say; the recordings themselves are the campaigns'."""

from typing import Any

import fleet_at_size
import fleet_at_size_page
import one_drive
import one_drive_page


def row(method: str, fault: str | None, reported_s: float | None, named: str = "fA_t") -> dict[str, Any]:
    """A recording of 480 s with a fault from 100 s on, or none, and one report."""
    said = [[named, 1, 0.9, [], []]]
    events = [] if reported_s is None else [[reported_s, max(reported_s - 100.0, 0.0), "occurred", said]]
    return {
        "method": method,
        "case": "made",
        "kind": "single" if fault else "free",
        "label": "small" if fault else "free",
        "faults": {fault: 0.1} if fault else {},
        "onset_s": 100.0 if fault else None,
        "seconds": 480.0,
        "exciting_s": 380.0,
        "cannot_tell": 0.0,
        "alarms": [],
        "events": events,
        "changes": True,
    }


def test_the_page_of_one_drive_counts_by_method() -> None:
    judged = [
        *(row("five", "fA_t", 120.0), row("five", "fA_p", None), row("five", None, None)),
        *(row("one", "fA_t", 420.0), row("one", "fA_p", 150.0), row("one", None, 200.0)),
        *(row("fleet", "fA_t", 110.0), row("fleet", "fA_p", 130.0, "fA_p"), row("fleet", None, None)),
    ]
    made = {"commit": "0123456", "wall_s": 1.0, "costs": {"five": 60.0, "one": 8.0}, "refused": {"fleet": "too far"}}
    fleet = {"vehicles": 14, "drives": 56, "hours": 8.8}
    text = one_drive_page.page([{"vehicle": 1, "judged": judged, "fleet": fleet, **made}])
    cells = {
        line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")[2:-1]]
        for line in text.splitlines()
        if "|" in line
    }
    assert [cell.split(",")[0] for cell in cells["small faults detected"]] == ["1 of 2", "1 of 2", "2 of 2"]
    assert [cell.split(",")[0] for cell in cells["in the set, of all"]] == ["1 of 2", "0 of 2", "2 of 2"]
    assert [cell.split(" ")[0] for cell in cells["false diagnoses"]] == ["0", "1", "0"]
    assert cells["vehicles refused by the tuning"] == ["0", "0", "1"]
    assert cells["tuning and export, CPU time, median"] == ["60 s", "8 s", "-"]
    assert cells["fA_p"] == ["0, 0 of 1", "1, 0 of 1", "1, 1 of 1"]


def test_the_vehicles_of_one_drive_are_none_of_the_fleets() -> None:
    assert not {*one_drive.FLEET} & {*one_drive.VEHICLES}
    assert [case.label for case in one_drive.cases(1021, "A")].count("free") == one_drive.FREE


def vehicle(fault: str | None, verdict: str, at: float | None, first: list[str]) -> dict[str, Any]:
    return {
        "vehicle": "made",
        "fault": fault,
        "onset_s": 300.0 if fault else None,
        "verdict": verdict,
        "occurred_s": at,
        "cpu_s": 2.0,
        "span_s": 600.0,
        "first": first,
    }


def test_the_page_of_a_fleet_counts_vehicles_and_costs() -> None:
    spent = {"wall_s": 10.0, "cpu_s": 18.0, "mib": 340.0, "code": 1}
    vehicles = [
        vehicle("fA_t", "fault", 320.0, ["fA_t"]),
        vehicle("leak_ap", "fault", 350.0, ["unknown"]),
        vehicle("fA_p", "fault", 200.0, ["fA_p"]),  # before its onset
        vehicle(None, "no fault", None, []),
        {"vehicle": "gone", "fault": None, "onset_s": None, "verdict": "lost"},
    ]
    costs = {"tune": {**spent, "hours": 0.5}}
    record = {"rig_cpu_s": 20.0, "rig_wall_s": 12.0, "diagnose": spent, "killed": True, "twice": 0}
    text = fleet_at_size_page.page([{**record, "vehicles": vehicles, "costs": costs, "commit": "0123456"}])
    assert "**5 vehicles, 0.7 vehicle-hours**" in text
    assert "| with a fault: found after its onset | 2 of 3" in text
    assert "| of those: the component among the best explanations | 2 of 2" in text
    assert "| false reports | 1 in" in text
    assert "| `fleet tune` | 36.0 s | 340 MiB |" in text
    assert "Workers killed at work: 1; drives without a row: 1, with two: 0." in text


def test_results_of_two_versions_are_not_added() -> None:
    records = [{"code": "a", "shard": 0}, {"code": "b", "shard": 1}, {"code": "b", "shard": 2}]
    assert [each["shard"] for each in fleet_at_size._same(records)] == [1, 2]
