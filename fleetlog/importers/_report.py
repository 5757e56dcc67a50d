"""What a file turned out to hold; an importer fills it while it reads, the summary prints it."""

from dataclasses import dataclass, field
from pathlib import Path

from fleetlog.errors import FormatError


@dataclass
class ReadReport:
    """Format, recognised columns, notes and damage of one file."""

    path: Path
    format: str = ""
    recognised: dict[str, str] = field(default_factory=dict)
    """Column or field of the log -> what it was taken for, as ``"speed, from km/h"``."""
    notes: list[str] = field(default_factory=list)  # Anything else that was decided and not asked for
    damage: list[str] = field(default_factory=list)
    """What is broken or cut off, where, and how much is whole; any entry makes the exit status 3."""

    def note(self, text: str) -> None:
        """Say something once."""
        if text not in self.notes:
            self.notes.append(text)

    def damaged(self, text: str) -> None:
        """Report damage once."""
        if text not in self.damage:
            self.damage.append(text)

    def nothing(self, what: str, do: str = "check the format") -> FormatError:
        """The error for a file that gave no row: what it holds, and the first damage that was met."""
        damage = f"; {self.damage[0]}" if self.damage else ""
        return FormatError(what + damage, where=self.path, do=do)
