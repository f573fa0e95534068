"""The person who watches: any key stops what moves."""

from __future__ import annotations

from tacshade_edge.capture.printer.safety_stop import Stopped
from tacshade_edge.capture.terminal import InputEnded, Terminal


class KeypressStop:
    """A hand on the keys of a terminal.

    Parameters
    ----------
    terminal : Terminal
        In its mode `keys` while anything moves.
    """

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def check(self) -> None:
        """Raises Stopped when a key was pressed, or nobody is there any more."""
        try:
            pressed = self._terminal.line() is not None
        except InputEnded:
            raise Stopped("the terminal has closed") from None
        if pressed:
            raise Stopped("a key was pressed")
