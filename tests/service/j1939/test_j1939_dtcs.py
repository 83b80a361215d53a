"""What of the fault memory is on the bus."""

import pytest
from j1939_service import fault

from faultline.service.core.j1939.dm1 import MOST, Code
from faultline.service.j1939.dtcs import Known, known, left_out, unsent


def test_no_fault_is_no_code_and_no_lamp() -> None:
    assert known([]) == Known((), (), amber=False)


def test_what_is_confirmed_and_there_is_active_and_what_was_there_is_previous() -> None:
    faults = [
        fault(1, (4374, 0), occurrences=2),
        fault(2, (4334, 18), there=False, occurrences=5),
        fault(3, (5394, 7), confirmed=False),  # pending: nobody is told yet
        fault(4, (1761, 1), there=False, confirmed=False),
    ]
    assert known(faults) == Known((Code(4374, 0, 2),), (Code(4334, 18, 5),), amber=True)
    assert known(faults[1:]) == Known((), (Code(4334, 18, 5),), amber=False)


def test_all_codes_of_an_ambiguity_group_are_sent_in_order() -> None:
    assert [code.spn for code in known([fault(1, (4374, 0), (5392, 31)), fault(2, (3362, 7))]).active] == [
        4374,
        5392,
        3362,
    ]


def test_a_code_that_several_faults_have_is_one_with_the_largest_count() -> None:
    faults = [fault(1, (4374, 0), occurrences=2), fault(2, (4374, 0), (4334, 1), occurrences=9)]
    assert known(faults).active == (Code(4374, 0, 9), Code(4334, 1, 9))
    assert known(faults[::-1]).active == (Code(4374, 0, 9), Code(4334, 1, 9))
    gone = [fault(1, (4374, 0), there=False, occurrences=12), *faults]
    assert known(gone) == Known((Code(4374, 0, 12), Code(4334, 1, 9)), (), amber=True)  # active, and not previous too


@pytest.mark.parametrize(("occurrences", "oc"), [(1, 1), (126, 126), (127, 126), (5000, 126)])
def test_a_count_ends_where_the_standard_ends_it(occurrences: int, oc: int) -> None:
    assert known([fault(1, (4374, 0), occurrences=occurrences)]).active == (Code(4374, 0, oc),)


def test_a_fault_without_a_code_lights_the_lamp_and_is_said() -> None:
    faults = [fault(1, components=("tank filter", "pump filter")), fault(2, components=(), there=False)]
    assert known(faults) == Known((), (), amber=True)
    assert unsent(faults) == {
        1: "fault 1 (tank filter, pump filter) has no SPN and FMI: no code of it is sent",
        2: "fault 2 (unknown) has no SPN and FMI: no code of it is sent",
    }
    assert unsent([fault(3, confirmed=False), fault(4, (4374, 0))]) == {}


@pytest.mark.parametrize("bad", [(0, 3), (524_287, 3), (524_288, 3), (-1, 3), (4374, 32), (4374, -1)])
def test_a_code_that_there_cannot_be_is_left_out_and_said(bad: tuple[int, int]) -> None:
    faults = [fault(1, bad, (4374, 0))]
    assert known(faults).active == (Code(4374, 0, 1),)
    assert unsent(faults) == {1: f"fault 1 (pump) has no valid code in SPN {bad[0]} FMI {bad[1]}: not sent"}


def test_how_many_are_too_many_is_known() -> None:
    many = [fault(1, *((spn, 1) for spn in range(1, MOST + 3))), fault(2, *((spn, 2) for spn in range(1, MOST + 1)))]
    assert left_out(known(many)) == MOST + 2
    assert left_out(known([fault(1, (1, 1))])) == 0


def test_a_change_of_state_is_one_of_codes_or_of_the_lamp() -> None:
    one = known([fault(1, (4374, 0), (4334, 1))])
    assert one.state == known([fault(1, (4334, 1), (4374, 0), occurrences=4)]).state
    assert one.state != known([fault(1, (4334, 1))]).state
    assert one.state != one._replace(amber=False).state
