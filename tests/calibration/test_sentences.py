from __future__ import annotations

import ast
import pickle
import string
from collections.abc import Iterator
from pathlib import Path

import tacshade_edge.calibration
from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.sentences import (
    PLAIN,
    SENTENCES,
    FindingError,
    Wording,
    sentence,
)
from tacshade_edge.cli.shared.finding_options import WITH_OPTIONS

CORE = Path(tacshade_edge.calibration.__file__).parent
WORDING = {"option", "sensor_file", "press_table"}


def fields(text: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(text) if name}


def made() -> Iterator[tuple[FindingCode | None, set[str]]]:
    """The code of each finding that the package makes (None: chosen at run time),
    and the names of its values.
    """
    for path in sorted(CORE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "finding":
                code = ast.unparse(node.args[0]).removeprefix("FindingCode.")
                names = {keyword.arg or "" for keyword in node.keywords} - {"left_out"}
                yield FindingCode.__members__.get(code), names


def test_every_code_has_a_sentence() -> None:
    assert set(SENTENCES) == set(FindingCode)


def test_every_finding_states_what_its_sentence_says() -> None:
    found = list(made())
    assert len(found) > 40
    for code, names in found:
        if code is not None:
            assert names == fields(SENTENCES[code]) - WORDING, code
        else:
            assert names in [fields(text) - WORDING for text in SENTENCES.values()], names


def test_a_command_helps_only_where_a_sentence_lets_it() -> None:
    helped = {code for code, text in SENTENCES.items() if "option" in fields(text)}
    assert set(WITH_OPTIONS.options) == helped
    assert not any("--" in text for text in SENTENCES.values())


def test_a_press_is_named_first_and_that_it_is_left_out_last() -> None:
    found = CalibrationFinding(FindingCode.NO_CONTACT, {"depth_mm": 1.5}, "press 3", left_out=True)
    said = "press 3: the image shows no contact, expected one 1.5 mm deep; left out"
    assert sentence(found) == said


def test_an_error_has_a_commands_words() -> None:
    error = FindingError(finding(FindingCode.TRAVEL), others=[finding(FindingCode.NO_PRESSES)])
    assert "first touch, judging by the images: state the" in str(error)
    wording = Wording(WITH_OPTIONS.options, press_table="dir/table.csv")
    worded = error.worded(wording)
    assert str(worded).startswith("dir/table.csv: depth_mm: found travel from first touch")
    assert "judging by the images: pass --depth-from-touch, or state the" in str(worded)
    assert worded.others == (sentence(finding(FindingCode.NO_PRESSES), PLAIN),)


def test_an_error_of_another_process_is_the_same() -> None:
    sent = FindingError(finding(FindingCode.TRAVEL), others=[finding(FindingCode.NO_PRESSES)])
    received = pickle.loads(pickle.dumps(sent))
    assert str(received) == str(sent)
    assert (received.findings, received.others, received.code) == (
        sent.findings,
        sent.others,
        sent.code,
    )
