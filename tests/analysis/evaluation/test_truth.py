"""The truth file: read whole, or refused with its name, what is wrong and what to do."""

from pathlib import Path

import pytest

from faultline.analysis.evaluation.truth import TrueFault, load_truth
from faultline.service.core.errors import InputError

GOOD = """
schema = 1
recording = "r"

[[fault]]
name = "fA_du"
size = 0.65
onset_s = 70
profile = "abrupt"

[effects]
wear = 0.1
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "truth.toml"
    path.write_text(text)
    return path


def test_a_whole_file_is_read(tmp_path: Path) -> None:
    truth = load_truth(written(tmp_path, GOOD), "r")
    assert truth.fault == [TrueFault(name="fA_du", size=0.65, onset_s=70.0, profile="abrupt")]
    assert truth.effects == {"wear": 0.1}


def test_a_fault_free_recording_needs_no_more_than_its_name(tmp_path: Path) -> None:
    truth = load_truth(written(tmp_path, 'schema = 1\nrecording = "r"\n'), "r")
    assert (truth.fault, truth.effects) == ([], {})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema = ", "not a truth file: Invalid value"),
        (GOOD.replace("0.65", '"much"'), r"not a truth file: Expected `float`, got `str` - at `\$.fault\[0\].size`"),
        (GOOD.replace("onset_s = 70\n", ""), "not a truth file: Object missing required field `onset_s`"),
        (GOOD.replace("profile", "shape"), "not a truth file: Object contains unknown field `shape`"),
        (GOOD.replace("schema = 1\n", ""), "not a truth file: Object missing required field `schema`"),
        (GOOD.replace("schema = 1", "schema = 2"), "schema: this is 2, wanted is 1; record again"),
        (GOOD.replace('"r"', '"other"'), "is about 'other', not about 'r'; give the truth of that recording"),
    ],
)
def test_a_file_that_is_no_truth_about_the_recording_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        load_truth(path, "r")
    assert str(caught.value).startswith(f"{path}: ")


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "truth.toml"
    path.write_bytes(b'recording = "\xff"')
    with pytest.raises(InputError, match="not a truth file"):
        load_truth(path, "r")


@pytest.mark.parametrize("name", ["absent.toml", "."])
def test_a_missing_file_says_who_writes_it(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="not found; the rig writes the truth with --truth"):
        load_truth(tmp_path / name, "r")
