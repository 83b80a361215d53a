"""Units beyond the vehicle's table, by pint: any of the right dimension, with offsets."""

from pathlib import Path

import pytest

from faultline.service.logs import open_log
from faultline.service.logs.units import conversion

KNOWN = {
    ("psi", "Pa"): (1.0, 6894.757293168361),
    ("PSI", "Pa"): (1.0, 6894.757293168361),
    ("BAR", "Pa"): (1.0, 1e5),
    ("kA", "A"): (1.0, 1e3),
    ("inHg", "Pa"): (1.0, 3386.388640341),
    ("mmHg", "Pa"): (1.0, 133.322387415),
    ("kgf/cm²", "Pa"): (1.0, 98066.5),
    ("kgf", "N"): (1.0, 9.80665),
    ("°F", "K"): (212.0, 373.15),
    ("degF/min", "K/s"): (108.0, 1.0),
    ("°C", "K"): (20.0, 293.15),
    ("L/100km", "m2"): (8.0, 8e-8),
    ("g/100 mL", "kg/m3"): (2.0, 20.0),
    ("m³/h", "m3/s"): (3600.0, 1.0),
    ("mph", "m/s"): (1.0, 0.44704),
    ("ft·lbf", "J"): (1.0, 1.3558179483314004),
    ("Nm", "N m"): (3.0, 3.0),
    ("PS", "W"): (1.0, 735.49875),
    ("lb/min", "kg/s"): (60.0, 0.45359237),
    ("kWh", "J"): (1.0, 3.6e6),
    ("ppm", "1"): (5e5, 0.5),
    ("m s-2", "m/s2"): (1.0, 1.0),
    ("rpm", "1/s"): (60.0, 1.0),
    ("rpm", "rad/s"): (60.0, 6.283185307179586),
    ("deg", "rad"): (180.0, 3.141592653589793),
}


@pytest.mark.parametrize(("units", "values"), KNOWN.items())
def test_any_unit_of_the_right_dimension(units: tuple[str, str], values: tuple[float, float]) -> None:
    how = conversion(*units)
    assert how is not None
    assert how.factor * values[0] + how.offset == pytest.approx(values[1], rel=1e-12)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("psi", "K"),
        ("A", "s"),
        ("kA", "s"),
        ("T", "kg"),
        ("Ah", "s"),
        ("pH", "s"),
        ("deg", "1"),
        ("rps", "1/s"),
        ("dBm", "W"),
        ("N/A", "1"),
        ("code", "Pa"),
        ("kg/(", "kg"),
        ("1/0", "1"),
        ("((", "1"),
        ("'", "m"),
        ("m" * 2000, "m"),
    ],
)
def test_another_dimension_a_logarithm_and_what_is_no_unit_are_none(given: str, wanted: str) -> None:
    assert conversion(given, wanted) is None


def test_a_table_in_any_unit_is_read(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t,p [psi],T (°F)\n0,100,68\n1,100,68\n")
    log = open_log(tmp_path / "x.csv")
    [piece] = log.signals(log.table({"p": "Pa", "T": "K"}, "x")).pieces()
    assert {name: column.value[0] for name, column in piece.columns.items()} == pytest.approx(
        {"p": 689475.7293168361, "T": 293.15}
    )
