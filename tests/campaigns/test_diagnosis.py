"""A fixed sample of the campaign: one vehicle, three faults; and the counting itself.

The sample's vehicle hides nothing and its days are calm (profile `realistic`): what it asserts is what is promised
without drift from one drive to the next. What days and hidden effects cost is the campaign's matter.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import diagnosis_plants
import pytest
from diagnosis import Record, is_made, kept_in, main, vehicle
from diagnosis_cases import HIDDEN, PAIRS, REFERENCE, VEHICLES, Set, cases, hidden, request
from diagnosis_judged import Judged, all_of, judged
from diagnosis_limits import beside_the_limit
from diagnosis_mates import excused, in_words, narrow
from diagnosis_page import PAGE, by_vehicle, latest, of_same_code, page, write_page
from diagnosis_shop import Workshop, run_of
from diagnosis_tables import smallest
from diagnosis_visible import changes
from false_alarms import hour
from results_page import exact_rate, poisson

from faultline.testbench.day import CALM
from faultline.testbench.effects import PROFILES
from faultline.testbench.faults import Fault

FAULTS = {"fA_t", "fA_du", "fy_p_du"}
NUMBER = REFERENCE[0]


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(NUMBER, "none", tmp_path_factory.mktemp("truck"))


@pytest.fixture(scope="module")
def told(shop: Workshop) -> Record:
    large = [case for case in cases(NUMBER, "none") if (case.kind, case.label) == ("single", "large")]
    free = [case for case in cases(NUMBER, "none") if case.kind == "free"][:1]
    wanted = [*free, *(case for case in large if {*dict(case.faults)} <= FAULTS)]
    return vehicle(shop, [replace(case, seconds=450.0) for case in wanted])


def test_a_workshop_takes_the_edges_that_are_proposed_once(tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.toml"
    sheet.write_text("[edges]\nsettle_s = 8.0\nsteps = {dc_dose = 0.03, n_p = 4.0}\n")
    told = "uds: n_p moves; system.toml, [edges]: steps = { dc_dose = 0.03, n_p = 1.1 }\nwrote model.toml"
    assert not diagnosis_plants.with_edges(sheet, "wrote model.toml")
    assert diagnosis_plants.with_edges(sheet, told)
    assert sheet.read_text().endswith("steps = { dc_dose = 0.03, n_p = 1.1 }\n")
    assert not diagnosis_plants.with_edges(sheet, told)


def test_large_faults_are_named_among_their_mates_and_nothing_is_told_without_one(told: Record) -> None:
    free, *looked = all_of([told])
    assert free.false == []
    assert len(looked) == 3
    for one in looked:
        limit = told["limit"][one.faults[0]]["large"]
        assert one.delay_s is not None, one
        assert limit["delay_s"] <= one.delay_s <= 60.0
        assert one.false == [], one
        assert one.holds(), one
        assert len(one.first()) <= 3, one
        assert one.excited_s is not None, one
        assert one.excited_s <= one.delay_s + 0.3, one  # a tick, and both are rounded


def test_an_hour_is_driven_and_counted(shop: Workshop, told: Record) -> None:
    driven = hour(shop, 0, 300.0)
    assert driven["false"] == driven["suspected"] == []
    assert by_vehicle([driven, driven])[-1].startswith("| all | 0 in 0.2 h")
    assert driven["seconds"] == 300.0
    stamp = {"commit": "abc", "code": "def"}
    said = page([{**told, **stamp}], [{**driven, **stamp}, {**driven, **stamp}])
    seconds = sum(one["onset_s"] if one["faults"] else one["seconds"] for one in told["judged"]) + 600.0
    assert f"| none in 500 h over 20 vehicles | 0 in {seconds / 3600:.1f} h" in said
    assert "| fA_t | large | 1 of 1, 100.0 % (2.5 to 100.0 %) |" in said


def test_vehicles_differ_in_what_they_hide_and_cases_do_not_share_seeds() -> None:
    assert len(PAIRS) == len(set(PAIRS)) == 30
    sets: tuple[Set, ...] = ("A", "B")
    for name in sets:
        chosen = [tuple(sorted(hidden(number, name))) for number in VEHICLES]
        assert {len(effects) for effects in chosen} == {1, 2}
        assert len(set(chosen)) > 8
        assert {effect for effects in chosen for effect in effects} == set(HIDDEN[name])
    for number in VEHICLES:
        asked = [case.request for name in sets for case in cases(number, name)]  # the rig refuses what cannot be
        assert all(one.day != CALM and {*PROFILES["everyday"]} <= {*one.effects} for one in asked)
        seeds = [case.seed for case in cases(number, "A")]
        assert len(seeds) == len(set(seeds))
    pairs = [case.faults for number in VEHICLES for case in cases(number, "A") if case.kind == "pair"]
    assert len(pairs) == 30


def made(number: int, *events: tuple[float, list[list[Any]]], label: str = "large", **faults: float) -> Record:
    """A record of what was told: (log time [s], diagnoses); the onset is at 150 s."""
    rows: list[list[Any]] = []
    for t, said in events:
        before = rows[-1][3] if rows else []
        rows.append(
            [t, max(t - 150.0, 0.0) / 2, "refined" if before and said else "occurred" if said else "healed", said]
        )
    told: Record = {"case": "c", "kind": "pair" if len(faults) > 1 else "single", "label": label, "faults": faults}
    told |= {"onset_s": 150.0, "seconds": 900.0, "exciting_s": 300.0, "cannot_tell": 0.0, "alarms": [], "events": rows}
    return {
        "vehicle": number,
        "effects": {"full_lift": 0.05},
        "doubts": [],
        "claim": "none",
        "cpu_s": 1.0,
        "judged": [told],
    }


def test_a_recording_is_judged_by_what_stood() -> None:
    both = [["fA_du", 1, None, []], ["fy_p_ap", 1, None, []], ["fA_ori", 3, None, []]]
    one = judged(401, made(401, (100.0, [["fA_ori", 1, None, []]]), (170.0, both), (400.0, []), fA_du=0.2)["judged"][0])
    assert one.false == [["fA_ori"]]
    assert (one.delay_s, one.excited_s) == (20.0, 10.0)
    assert one.first(60.0) == ["fA_du", "fy_p_ap"]
    assert one.holds(120.0)
    assert one.first(300.0) == []
    assert not one.holds(300.0)
    alone = judged(401, made(401, (170.0, [["fA_ori", 1, None, []]]), fA_du=0.2)["judged"][0])
    assert alone.wrong_alone()
    unknown = judged(401, made(401, (170.0, [["unknown", 1, None, ["e10"]]]), fA_du=0.2)["judged"][0])
    assert not unknown.wrong_alone()
    crept = made(401, (140.0, [["fA_ori", 1, 0.9, []]]), (170.0, [["fA_ori", 1, 0.8, []]]), fA_du=0.2)
    assert not judged(401, crept["judged"][0]).detected  # a probability that creeps is no news
    standing = judged(401, made(401, (100.0, [["fA_ori", 1, None, []]]), fA_du=0.2)["judged"][0])
    assert not standing.detected
    pair = judged(401, made(401, (170.0, [["fA_du+fA_t", 1, None, []]]), fA_t=0.3, fA_du=0.2)["judged"][0])
    assert pair.holds()
    assert not pair.wrong_alone()
    other = judged(401, made(401, (170.0, [["fA_ori", 1, None, []]]), fA_t=0.3, fA_du=0.2)["judged"][0])
    assert other.wrong_alone()


def test_mates_come_from_the_other_half() -> None:
    both: list[list[Any]] = [["fA_du", 1, None, []], ["fy_p_ap", 1, None, []]]
    three = [*both, ["fA_ori", 1, None, []]]
    told = {401: both, 403: both, 402: three, 404: three, 405: three}
    looked = all_of([made(number, (170.0, said), fA_du=0.2) for number, said in told.items()])
    table = excused(looked)
    assert table[0]["fA_du", "large"] == {"fy_p_ap"}  # of the odd ones, for the even ones; fA_ori once is chance
    assert table[1]["fA_du", "large"] == {"fy_p_ap", "fA_ori"}
    assert [narrow(one, table) for one in looked] == [True, True, False, False, True]
    assert in_words(table, "large") == "fA_du with fA_ori, fy_p_ap"
    assert in_words(table, "small") == in_words(table, "large", ["fA_du"]) == "none"
    rare = [made(401 + 2 * k, (170.0, three if k < 2 else both), fA_du=0.2) for k in range(11)]
    assert excused(all_of(rare))[0]["fA_du", "large"] == {"fy_p_ap"}  # twice in eleven is no fifth


def test_the_page_has_every_part() -> None:
    stamp = {"commit": "abc", "code": "def"}
    ori: list[list[Any]] = [["fA_ori", 1, None, []]]
    records = [
        made(401, (170.0, [["fA_du", 1, 0.9, []]]), fA_du=0.2),
        made(
            402,
            (100.0, ori),
            (120.0, []),
            (300.0, [["fA_t", 1, None, []]]),
            label="small",
            fA_t=0.1,
        ),
        made(402, (170.0, [["unknown", 1, None, ["e10"]]]), leak_ap=0.1),
        made(403, (170.0, [["fA_du+fA_t", 1, None, []]]), fA_t=0.3, fA_du=0.2),
        made(404, fA_p=0.8),
    ]
    records[4]["judged"][0]["changes"] = False
    said = page([{**record, **stamp} for record in records])
    assert "| large: alone | - | 1 of 1" in said
    assert "; mates: none |" in said
    assert "| large: detected | 100 % | 1 of 1, 100.0 % (2.5 to 100.0 %) |" in said
    assert "| fault-free: diagnoses told | none in 500 h over 20 vehicles | 1 in 0.2 h" in said
    assert "| small: detected within 300 s of exciting operation | >= 90 % | 1 of 1" in said
    assert "| leak: unknown, near the hose's balance, alone or among others | 100 % | 1 of 1" in said
    assert "| leak: unknown, near the hose's balance, alone | - | 1 of 1" in said
    assert "| pairs: the true pair in the diagnosis | >= 60 % | 1 of 1" in said
    assert "| fA_p that changes nothing: quiet | 100 % | 1 of 1" in said
    assert "| fA_t + fA_du | 20 | fA_du+fA_t | yes |" in said
    assert "| full_lift | 4 | 1 in 0.2 h" in said
    a, b = ({"code": code, "tuning": "own", "vehicle": 401, "of": code} for code in "ab")
    c, again = {**b, "vehicle": 402}, {**b, "of": "again"}
    assert latest([a, b, {**b, "tuning": "adapted"}, c, again]) == [again, c]


def test_a_fault_changes_what_is_measured_or_does_not() -> None:
    """A clogged pump filter that starves no pump shows where the pump's ripple reaches the sensor before it."""
    quiet = replace(request(301, "A", "maximum", 5, 120.0), effects=PROFILES["realistic"])
    pulsing = replace(quiet, effects={**PROFILES["realistic"], "suction_pulsation": 10.0})
    told = {}
    for name, healthy in (("quiet", quiet), ("pulsing", pulsing)):
        clogged = replace(healthy, faults=(Fault("fA_p", 0.7, 60.0),))
        told[name] = changes(clogged, run_of(clogged), run_of(healthy))
    large = replace(quiet, faults=(Fault("fA_t", 0.333, 60.0),))
    told["fA_t"] = changes(large, run_of(large), run_of(quiet))
    assert told == {"quiet": False, "pulsing": True, "fA_t": True}


def test_small_faults_are_counted_beside_their_limit() -> None:
    def one(vehicle: int, fault: str, excited_s: float | None, size: float) -> Judged:
        said = {300.0: [(fault, 1, 0.99, (), [(-30.0, -20.0, "%")])]} if excited_s is not None else {}
        return Judged(
            vehicle, "single", "small", (fault,), 100.0, [], [], excited_s, excited_s, said, 0.0, True, (size,)
        )

    told = [one(1, "fA_t", 40.0, 0.25), one(2, "fA_t", None, 0.25), one(1, "fA_du", 310.0, 0.35)]
    limits = {
        number: {
            "fA_t": {"small": {"delay_s": 20.0, "within": 1.0 if number == 1 else 0.2, "others": ["fA_p"]}},
            "fA_du": {"small": {"delay_s": 20.0, "within": 0.5, "others": []}},
        }
        for number in (1, 2)
    }
    found = "\n".join(beside_the_limit(told, limits))
    assert "exciting operation | >= 85 % | 1 of 2" in found
    assert "the same | >= 75 % | 1 of 3" in found
    assert "| 1.00 to 1.50 |" in found
    assert "has it | 90 to 98 % | 1 of 2" in found
    assert "| fA_t | 2 | 1 | 1 of 2, 50.0 % (1.3 to 98.7 %) | 40 | 20 | 2.0 |" in found


def test_hours_count_with_the_code_that_made_the_records() -> None:
    record, other = ({"code": code, "tuning": "own"} for code in "ab")
    assert of_same_code([record, other], [record]) == [record]


def test_the_interval_of_a_count_is_garwoods() -> None:
    assert poisson(0) == pytest.approx((0.0, 2.996), abs=1e-3)
    assert poisson(3) == pytest.approx((0.619, 8.767), abs=1e-3)


def test_at_most_is_one_sided_and_an_interval_is_not() -> None:
    assert exact_rate(0, 10.0) == "0 in 10.0 h, at most 0.3 an hour"
    assert exact_rate(3, 10.0) == "3 in 10.0 h, 0.3 (0.062 to 0.88) an hour"


def test_the_smallest_size_is_that_from_which_on_all_are_detected() -> None:
    def driven(fault: str, size: float, seen: bool) -> Record:
        events = [(170.0, [[fault, 1, None, []]])] if seen else []
        record = made(401, *events)
        record["judged"][0]["faults"] = {fault: size}
        return record

    told = [driven("fA_t", size, seen) for size, seen in ((0.1, True), (0.2, False), (0.3, True), (0.4, True))]
    told += [driven("fA_t", 0.3, True), driven("fA_du", 0.1, True), driven("fA_du", 0.2, True)]
    told += [driven("fA_ori", 0.1, True), driven("fA_ori", 0.2, True), driven("fA_ori", 0.2, False)]
    unseen = driven("fA_p", 0.8, False)
    unseen["judged"][0]["changes"] = False
    assert smallest(all_of([*told, unseen]))[2:] == [
        "| fA_t | 0.1, 0.2, 0.3, 0.4 | 0.3 | 3 |",
        "| fA_du | 0.1, 0.2 | below the grid (<= 0.1) | 2 |",
        "| fA_ori | 0.1, 0.2 | above the grid (> 0.2) | 1 of 2 detected at 0.2 |",
    ]


def test_a_vehicle_is_made_with_the_same_code_and_tuning_and_all_its_cases() -> None:
    wanted = cases(401, "A")
    judged_ones = [{"case": case.name} for case in wanted]
    record = {"vehicle": 401, "code": "a", "tuning": "own", "judged": judged_ones}
    assert is_made(401, wanted, [record], "a", "own")
    assert not is_made(402, wanted, [record], "a", "own")
    assert not is_made(401, wanted, [record], "b", "own")
    assert not is_made(401, wanted, [record], "a", "adapted")
    assert not is_made(401, wanted, [{**record, "judged": judged_ones[1:]}], "a", "own")
    assert kept_in("A").name == "diagnosis-A.jsonl"
    assert kept_in("A", part=True).name == "diagnosis-A-part.jsonl"


def test_a_page_has_records_of_one_code_or_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="run make campaign-diagnosis first"):
        main(["--page-only", "--results", str(tmp_path)])
    assert not (tmp_path / PAGE).exists()
    stamps = [{"commit": code, "code": code, "tuning": "own"} for code in ("old", "new")]
    records = [{**made(401 + k, fA_t=0.3), **stamp} for k, stamp in enumerate(stamps)]
    kept_in("A", tmp_path).write_text("".join(json.dumps(record) + "\n" for record in records))
    write_page(tmp_path)
    said = (tmp_path / PAGE).read_text()
    assert "1 vehicles, 1 recordings." in said
    assert "Commit new, code new," in said
