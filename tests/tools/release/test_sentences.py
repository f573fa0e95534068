"""Sentences drawn for a reader: the same for a seed, prose only, from each source."""

from __future__ import annotations

from tools.release.sentences import collect, draw, messages, prose

MARKDOWN = """# A heading

The broker rejects
the message.

```
code that nobody reads
```
- An item of a list.

    indented code that nobody reads

| short cell | a cell that has five words |
|---|---|
"""

MODULE = '''
LATE = "no frame within {:.0f} s"

def check(path, size):
    """This is no message."""
    found = f"found {size} bytes" if size else "found nothing"
    _log.info("%s: read %d bytes", path, size)
    unused = "a string that nobody prints"
    raise DecodeError(f"{path}: {found}, expected 8")

def late():
    return Reason(Code.TIMEOUT, LATE.format(2))
'''


def test_a_seed_draws_the_same_sentences_from_each_source() -> None:
    drawn = draw(1, 40)
    assert drawn == draw(1, 40) != draw(2, 40)
    assert len(set(drawn)) == 40
    for source in ("docs", "help", "messages"):
        assert len(set(drawn) & set(collect(source))) >= 13


def test_prose_is_paragraphs_items_and_long_cells() -> None:
    assert list(prose(MARKDOWN)) == [
        (3, "The broker rejects the message."),
        (9, "An item of a list."),
        (13, "a cell that has five words"),
    ]


def test_messages_are_what_a_user_sees_with_dots_for_values() -> None:
    assert {text for _, text in messages(MODULE)} == {
        "...: read ... bytes",
        "...: ..., expected 8",
        "found ... bytes",
        "found nothing",
        "no frame within ... s",
    }
