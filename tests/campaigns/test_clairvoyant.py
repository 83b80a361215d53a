"""A fixed sample of the campaign, on the golden recording, and the counting itself."""

from pathlib import Path

from clairvoyant import Record, delays_of, faster, page, ratio
from diagnosis_limit import blocks_of

from faultline.service.bundle.load import load_bundle
from faultline.service.logs import open_log
from faultline.testbench.traffic import Frame

GOLDEN = Path(__file__).parents[1] / "golden"


def test_the_clairvoyant_is_near_the_limit() -> None:
    bundle = load_bundle(GOLDEN / "bundle")
    sent = [Frame(t, can_id, data) for t, can_id, _, data in open_log(GOLDEN / "log").relative()]
    found = delays_of(bundle, blocks_of(bundle, sent), "fA_du", 0.65, 70.0)
    assert found["early_s"] is not None
    assert found["clairvoyant_s"] is not None
    assert found["limit_s"] is not None
    assert found["early_s"] <= found["clairvoyant_s"] <= 2.0 * found["limit_s"]
    other = delays_of(bundle, blocks_of(bundle, sent), "fA_t", 0.65, 70.0)
    assert other["clairvoyant_s"] is None, "there is no such fault in it"
    assert delays_of(bundle, blocks_of(bundle, sent), "fA_du", 0.65, 500.0)["limit_s"] is None


def test_what_is_faster_than_the_limit_is_counted() -> None:
    cases: list[Record] = [
        {"fault": "fA_t", "label": "small", "clairvoyant_s": 9.0, "limit_s": 12.0, "early_s": 6.0},
        {"fault": "fA_t", "label": "small", "clairvoyant_s": 3.0, "limit_s": 12.0, "early_s": 6.0},
        {"fault": "fA_t", "label": "large", "clairvoyant_s": None, "limit_s": 30.0, "early_s": 20.0},
        {"fault": "fA_du", "label": "small", "clairvoyant_s": None, "limit_s": None, "early_s": None},
    ]
    assert [faster(case) for case in cases] == [False, True, False, False]
    assert ratio(cases) == "0.75"
    record = {"vehicle": 911, "refused": None, "commit": "abc", "wall_s": 1.0, "cases": cases}
    said = page([record])
    assert "| <= 5 % | 1 of 3, 33.3 % (0.8 to 90.6 %) |" in said
    assert "| fA_t | small | 2 | 6 | 12 | 0.50 | 1 |" in said
    assert "| fA_t | large | 1 | never | 30 | inf | 0 |" in said
