"""Any key that the watching person presses stops the head."""

from __future__ import annotations

from tacshade_edge.capture.printer.safety_stop import Stopped
from tacshade_edge.capture.terminal import InputEnded, Terminal


class KeypressStop:
    """A check for keypresses at a terminal.

    Parameters
    ----------
    terminal : Terminal
        Inside its `keys` context while anything moves.
    """

    def __init__(self, terminal: Terminal) -> None:
        self._terminal = terminal

    def check(self) -> None:
        """Raise Stopped if a key was pressed or the terminal has closed."""
        try:
            pressed = self._terminal.line() is not None
        except InputEnded:
            raise Stopped("the terminal has closed") from None
        if pressed:
            raise Stopped("a key was pressed")
