"""What a session tells and asks the user, and the user's settings."""

from __future__ import annotations

from dataclasses import dataclass, field

from app.model.settings import Settings, load_settings, save_settings
from app.session.question import Choice, Question
from app.translation import _

__all__ = ["Messages"]


@dataclass
class Messages:
    """The status line, an error, a question, and settings, which are saved as they change."""

    settings: Settings = field(default_factory=load_settings)
    message: str = ""
    """The status line."""
    error: str = ""
    """One line that stays until the user dismisses it."""
    question: Question | None = None

    def notify(self, text: str) -> None:
        """Shows a message in the status line."""
        self.message = text

    def show_error(self, error: Exception | str) -> None:
        """Shows an error until the user dismisses it."""
        self.error = str(error)

    def show_failure(self, error: Exception) -> None:
        """Shows an error that nobody has foreseen."""
        text = _("Something went wrong ({kind}: {error}). Your work is kept; save it.")
        self.show_error(text.format(kind=type(error).__name__, error=error))

    def ask(self, title: str, text: str, *choices: Choice) -> None:
        """Asks the user to choose; Cancel is added as the last choice."""
        self.question = Question(title, text, (*choices, Choice(_("Cancel"), lambda: None)))

    def answer(self, choice: Choice) -> None:
        """Carries out what the user chose, which may ask the next question."""
        self.question = None
        choice.act()

    def change_settings(self, settings: Settings) -> None:
        """Replaces the settings and saves them."""
        if settings != self.settings:
            self.settings = settings
            save_settings(settings)
