"""Counts of the fault bench's trials, and the tests that they name."""

from __future__ import annotations

from xml.etree import ElementTree

from tools.faults import trials
from tools.faults.trials import TREE, TRIALS, Counted, Trial

RESULTS = """<testsuites><testsuite>
<testcase classname="tests.files.test_a" name="test_x[1]" time="1.5">
<properties><property name="tried" value="7"/></properties></testcase>
<testcase classname="tests.files.test_a" name="test_y" time="0.5"><failure/></testcase>
<testcase classname="tests.files.test_b" name="test_z" time="2"><skipped/></testcase>
</testsuite></testsuites>"""


def test_what_was_tried_is_counted_by_trial() -> None:
    named = (Trial("a", ("tests/files/test_a.py",)), Trial("b", ("tests/files/test_b.py::test_z",)))
    found = trials.count(named, ElementTree.fromstring(RESULTS))
    assert found == {"a": Counted(2, 8, 1, 0, 2.0), "b": Counted(0, 0, 0, 1, 2.0)}
    assert "| a | 2 | 8 | 1 | 0 | 2 |" in trials.table(found)


def test_every_trial_has_tests() -> None:
    files = [test.partition("::") for trial in TRIALS for test in trial.tests]
    assert len({name for name, _, _ in files}) > 10
    for name, _, test in files:
        assert f"def {test}" in (TREE / name).read_text(encoding="utf-8")
