"""What is pure: health in a word, the ring of records, answers and errors."""

import msgspec
import pytest
from web_daemon import record

from faultline.service.core.records.health import Standing
from faultline.service.protocol.answers import ServiceState
from faultline.service.protocol.client import decode
from faultline.service.protocol.errors import AwayError, GarbledError, RefusedError
from faultline.service.protocol.records import RecordError
from faultline.service.web.asking import Pace
from faultline.service.web.health import BLINDING, away, health_of, is_well
from faultline.service.web.problems import error_of
from faultline.service.web.ring import Ring, told


class TestHealth:
    def state(self, *kinds: str) -> ServiceState:
        return ServiceState(
            source="truck", version="1", seq=9, conditions=[Standing(kind=kind, of="can") for kind in kinds]
        )

    def test_one_word(self) -> None:
        assert health_of(self.state()).status == "well"
        assert health_of(self.state("frames-lost")).status == "degraded"
        assert health_of(self.state("frames-lost", "no-traffic")).status == "blind"
        assert away("gone").status == "away"

    @pytest.mark.parametrize("kind", sorted(BLINDING))
    def test_who_is_blind_is_not_well(self, kind: str) -> None:
        assert not is_well(health_of(self.state(kind)))

    def test_what_is_not_known_is_told_and_blinds_nobody(self) -> None:
        body = health_of(self.state("of-tomorrow"))
        assert (body.status, body.detail) == ("degraded", "can of-tomorrow")
        assert is_well(body)

    def test_says_the_cursor_and_what_blinds(self) -> None:
        body = health_of(self.state("frames-lost", "bus-off"))
        assert body.cursor == 9
        assert body.detail == "can the controller has left the bus after too many errors"


class TestRing:
    def ring(self, *seqs: int, size: int = 4) -> Ring:
        ring = Ring(size)
        for seq in seqs:
            ring.add(told(record(seq)))
        return ring

    def test_what_comes_twice_is_one(self) -> None:
        ring = self.ring(1, 2)
        assert not ring.add(told(record(2)))
        assert ring.add(told(record(3)))
        assert (ring.end, ring.newest, ring.last) == (3, 3, "truck-5e0c72b1-3")

    def test_places(self) -> None:
        ring = self.ring(1, 2, 3, 4, 5, 6)
        assert (ring.oldest, ring.end) == (2, 6)
        assert [ring.after(seq) for seq in range(8)] == [None, None, 2, 3, 4, 5, 6, None]
        assert (ring.where("truck-5e0c72b1-2"), ring.where("truck-5e0c72b1-3")) == (None, 2)

    def test_an_empty_one_knows_no_place(self) -> None:
        ring = self.ring()
        assert (ring.after(0), ring.last, ring.newest, ring.since(0, 9)) == (None, None, 0, [])
        assert ring.beyond(0) == 0

    def test_a_gap_in_numbers_is_no_place_less(self) -> None:
        ring = self.ring(10, 20, 30)
        assert [ring.after(seq) for seq in (8, 9, 10, 15, 29, 30)] == [None, 0, 1, 1, 2, 3]
        assert [ring.beyond(seq) for seq in (0, 15, 99)] == [0, 1, 3]

    def test_since(self) -> None:
        ring = self.ring(1, 2, 3, 4, 5, 6)
        assert ring.since(1, 9) is None
        assert [each.seq for each in ring.since(2, 9) or ()] == [3, 4, 5, 6]
        assert [each.seq for each in ring.since(4, 1) or ()] == [5]
        assert ring.since(6, 9) == []

    def test_kinds(self) -> None:
        assert [told(record(seq)).kind for seq in (1, 5, 11)] == ["fault", "health", "cleared"]
        assert told(b'{"schema":"faultline.event/1","id":"a-1","seq":1}\n').line.endswith(b"1}")

    @pytest.mark.parametrize(
        "line",
        [
            *(b"", b"{}", b"\xff\xfe\n", b'{"schema":"other/1","id":"a-1","seq":1}'),
            b'{"schema":"faultline.event/1","id":"a\\nevent: x","seq":1}',
            b'{"schema":"faultline.event/1","id":"","seq":1}',
        ],
    )
    def test_what_is_no_record(self, line: bytes) -> None:
        with pytest.raises(RecordError):
            told(line)


class TestAnswers:
    def test_errors_of_the_daemon_become_statuses(self) -> None:
        statuses = {
            code: error_of(RefusedError(code, "why")).status
            for code in ("unknown", "not-allowed", "not-kept", "busy", "bad-request", "of-tomorrow")
        }
        known = {"unknown": 404, "not-allowed": 403, "not-kept": 500, "busy": 503}
        assert statuses == {**known, "bad-request": 502, "of-tomorrow": 502}
        assert error_of(AwayError("x")).headers == {"retry-after": "1"}
        assert error_of(ValueError("secret")).detail == "this server has failed; its log says why"

    def test_a_problem_says_all_of_it(self) -> None:
        body = msgspec.json.decode(error_of(RefusedError("not-kept", "why")).body)
        assert body == {
            "type": "urn:faultline:problem:not-kept",
            "title": "Internal Server Error",
            "status": 500,
            "detail": "why",
            "code": "not-kept",
        }

    @pytest.mark.parametrize("line", [b"", b"[]\n", b'{"seq":1}\n', b'{"error":"x"}\n', b'{"source":1}\n', b"\xff\n"])
    def test_what_cannot_be_read(self, line: bytes) -> None:
        with pytest.raises(GarbledError):
            decode(line, ServiceState)

    def test_a_newer_daemon_may_say_more(self) -> None:
        line = b'{"source":"a","version":"9","seq":1,"more":{},"systems":[{"name":"x","more":1}]}\n'
        assert decode(line, ServiceState).systems[0].name == "x"

    def test_questions_are_spaced_after_a_burst(self) -> None:
        now = [0.0]
        pace = Pace(rate=8.0, burst=4, clock=lambda: now[0])
        assert [pace.wait() for _ in range(7)] == [0, 0, 0, 0, 0, 0.125, 0.25]
        now[0] = 16.0
        assert [pace.wait() for _ in range(21)][-3:] == [1.75, 1.875, 2.0]
        with pytest.raises(RefusedError, match="too many"):
            pace.wait()
