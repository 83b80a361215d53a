"""The fault memory as SOVD sees it, and what may be asked of it."""

from typing import Any

import msgspec
import pytest
from starlette.datastructures import QueryParams
from web_daemon import FAILED, NAMES, PASSED, PENDING, fault, status

from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Status
from faultline.service.protocol.answers import FreezeFrames
from faultline.service.protocol.live import FaultMeaning
from faultline.service.web.faults import STATUS_KEYS, aggregated, detail_of, item_of, selected, value_of
from faultline.service.web.problems import error_of
from faultline.service.web.queries import filter_of, nothing_in, page_of, parts_of

MEANINGS = {each.name: each for each in msgspec.convert(NAMES, list[FaultMeaning])}


def encoded(value: object) -> Any:
    return msgspec.json.decode(msgspec.json.encode(value))


class TestFaults:
    def test_an_item_has_the_names_and_forms_of_sovd(self) -> None:
        item = encoded(item_of(fault(3), MEANINGS))
        assert item == {
            "code": "3",
            "scope": "Default",
            "display_code": "520192-11",
            "fault_name": "dosing unit filter: clogged or pump pressure sensor: drifts",
            "severity": 2,
            "status": {
                "aggregatedStatus": "active",
                "testFailed": "1",
                "testFailedThisOperationCycle": "1",
                "pendingDTC": "1",
                "confirmedDTC": "1",
                "testNotCompletedSinceLastClear": "0",
                "testFailedSinceLastClear": "0",
                "testNotCompletedThisOperationCycle": "0",
                "warningIndicatorRequested": "1",
                "mask": "0x8F",
            },
            "symptom": "tests t02, t05 fired in mode partial",
            "candidates": [
                {"components": ["dosing unit filter"], "faults": ["fA_du"], "p": 0.7, "rank": 1, "near": []},
                {"components": ["pump pressure sensor"], "faults": ["fy_p_ap"], "p": 0.2, "rank": 1, "near": []},
                {"components": [], "faults": [], "p": None, "rank": 2, "near": ["e3"]},
            ],
        }

    @pytest.mark.parametrize("bit", range(8))
    def test_every_bit_has_its_key_and_its_place_in_the_mask(self, bit: int) -> None:
        names = [field.name for field in msgspec.structs.fields(Status)]
        shown = item_of(fault(1, state=status(**{names[bit]: True})), {}).status
        assert shown.mask == f"0x{1 << bit:02X}"
        assert {key for key in STATUS_KEYS if value_of(shown, key) == "1"} == {STATUS_KEYS[bit]}
        assert {key for key in STATUS_KEYS if encoded(shown)[key] == "1"} == {STATUS_KEYS[bit]}

    @pytest.mark.parametrize(
        ("state", "word"),
        [
            (FAILED, "active"),
            (PENDING, "active"),
            (PASSED, "passive"),
            (status(pending=True), "passive"),
            (status(warning=True), "passive"),
            (status(failed_since_clear=True, not_completed_this_cycle=True), "cleared"),
        ],
    )
    def test_all_of_it_in_a_word(self, state: Status, word: str) -> None:
        assert aggregated(state) == word

    def test_what_is_not_warned_of_is_less_severe(self) -> None:
        assert item_of(fault(1, state=PASSED), {}).severity == 3

    @pytest.mark.parametrize(
        ("diagnoses", "name"),
        [
            ([], "unknown"),
            ([Diagnosis(faults=[], rank=1, p=None)], "unknown"),
            ([Diagnosis(faults=[], rank=1, p=None, near=["e1", "e2"])], "unknown, near e1, e2"),
            ([Diagnosis(faults=["fq"], rank=1, p=0.5)], "fq"),
            (
                [Diagnosis(faults=["fA_du", "fq"], rank=1, p=None), Diagnosis(faults=["fy_p_ap"], rank=2, p=0.1)],
                "dosing unit filter: clogged and fq",
            ),
        ],
    )
    def test_a_name_says_the_best_and_only_what_is_known(self, diagnoses: list[Diagnosis], name: str) -> None:
        assert item_of(fault(1, diagnoses=diagnoses), MEANINGS).fault_name == name

    def test_a_candidate_without_a_meaning_keeps_its_name_and_one_component_is_named_once(self) -> None:
        diagnoses = [Diagnosis(faults=["fq"], rank=1, p=None), Diagnosis(faults=["fA_du", "fA_du"], rank=2, p=None)]
        candidates = item_of(fault(1, diagnoses=diagnoses), MEANINGS).candidates
        assert [each.components for each in candidates] == [["fq"], ["dosing unit filter"]]

    def test_what_no_test_showed_says_so(self) -> None:
        assert "no test fired" in item_of(fault(1, tests=[]), {}).symptom
        assert item_of(fault(1, modes=[]), {}).symptom == "tests t02, t05 fired"

    def test_details_carry_counts_and_frames_unless_they_are_left_out(self) -> None:
        frames = FreezeFrames(first=msgspec.Raw(b'{"tick":1}'), latest=msgspec.Raw(b'{"tick":2}'))
        whole = encoded(detail_of(fault(3), MEANINGS, frames))
        assert whole["environment_data"]["snapshots"] == [
            {"record": "first", "data": {"tick": 1}},
            {"record": "latest", "data": {"tick": 2}},
        ]
        extended = whole["environment_data"]["extended_data_records"]
        assert (extended["occurrences"], extended["fdc"], extended["first"]["cycle"]) == (2, 127, 7)
        assert extended["dtcs"] == [{"spn": 520192, "fmi": 11}]
        only = encoded(detail_of(fault(3), MEANINGS, frames, snapshots=False))["environment_data"]
        assert [*only] == ["extended_data_records"]
        assert encoded(detail_of(fault(3), {}, FreezeFrames(), extended=False))["environment_data"] == {"snapshots": []}


class TestFilter:
    ITEMS = tuple(item_of(each, {}) for each in (fault(1), fault(2, state=PASSED), fault(3, state=PENDING)))

    @pytest.mark.parametrize(
        ("query", "codes"),
        [
            ("", "123"),
            ("status[confirmedDTC]=true", "12"),
            ("status[confirmedDtc]=1", "12"),
            ("status[CONFIRMEDDTC]=false", "3"),
            ("status[testFailed]=0", "2"),
            ("status[testFailed]=true&status[confirmedDTC]=true", "123"),  # any is enough
            ("status[warningIndicatorRequested]=1&status[testFailedSinceLastClear]=1", "12"),
            ("status[testFailed]=1&status[testFailed]=0", "123"),
            ("status[aggregatedStatus]=passive", "2"),
            ("status[aggregatedStatus]=cleared", ""),
            ("severity=2", "1"),
            ("severity=3&status[testFailed]=1", "3"),
            ("scope=Default", "123"),
            ("scope=Other", ""),
        ],
    )
    def test_selects(self, query: str, codes: str) -> None:
        wanted = filter_of(QueryParams(query))
        found = selected(self.ITEMS, wanted.status, wanted.severity, wanted.scope)
        assert "".join(item.code for item in found) == codes

    @pytest.mark.parametrize(
        "query",
        [
            *(
                "status[confirmed]=1",
                "status[testFailed]=yes",
                "status=1",
                "status[]=1",
                "status[aggregatedStatus]=old",
            ),
            *("severity=0", "severity=5", "severity=x", "severity=-1", "severity=", "severity=2&severity=2"),
            *("scope=", "scope=a b", "Scope=a", "other=1", "severity=%D9%A2"),
        ],
    )
    def test_refuses_by_name(self, query: str) -> None:
        with pytest.raises(Exception, match=r"severity|scope|status|Scope|other") as caught:
            filter_of(QueryParams(query))
        assert error_of(caught.value).status == 400

    def test_pages_and_parts(self) -> None:
        assert page_of(QueryParams("")) == (100, None, None)
        assert page_of(QueryParams("after=0&count=500")) == (500, 0, None)
        assert page_of(QueryParams("before=12&after=3")) == (100, 3, 12)
        assert parts_of(QueryParams("")) == (True, True)
        assert parts_of(QueryParams("include-extended-data=false&include-snapshot-data=1")) == (False, True)

    @pytest.mark.parametrize(
        "query", ["count=0", "count=501", "after=1&after=2", "after=x", "after=1e3", f"after={2**53}"]
    )
    def test_pages_that_make_no_sense(self, query: str) -> None:
        with pytest.raises(Exception, match=r"count|after"):
            page_of(QueryParams(query))

    def test_nothing_is_nothing(self) -> None:
        nothing_in(QueryParams(""))
        with pytest.raises(Exception, match="takes none"):
            nothing_in(QueryParams("a=1"))
