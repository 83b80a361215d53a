"""Two of the campaign's trucks: parameters within their intervals, the free run near the channels' noise."""

from calibration import campaign, page

from faultline.analysis.calibration.validate import STEADY


def test_two_trucks_are_found() -> None:
    results = campaign(2)
    for result in results:
        assert not result.told["A_p"]  # nothing is measured behind the pump filter
        for name, error in result.error.items():
            assert abs(error) < 2.0 * result.half[name], (result.name, name)
        for output, by_mode in result.agreement.items():
            steady = by_mode[STEADY]
            assert steady.rms < 1.2 * steady.floor, (result.name, output)
    inside = sum(abs(error) <= result.half[name] for result in results for name, error in result.error.items())
    assert inside >= 12  # of 14
    text = page(results, 20.0, "0123456", 60.0)
    assert f"Within the stated 95 % intervals: {inside} of 14" in text
    assert "| y_p_du | steady |" in text
