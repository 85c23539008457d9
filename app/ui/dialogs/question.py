"""A question that the user must answer before anything else."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from app.session.session import Session
from app.ui.theme import Fonts, px
from app.ui.widgets import font, main_button, modal, secondary

__all__ = ["show_question"]


def show_question(session: Session) -> None:
    """Shows the session's question until it is answered; Esc chooses its last answer."""
    question = session.question
    if question is None:
        return
    imgui.open_popup("Question")
    chosen = None
    with modal("Question", 440) as opened:
        if not opened:
            return
        with font(Fonts.bold):
            imgui.text_unformatted(question.title)
        secondary(question.text, wrap=True)
        imgui.dummy(ImVec2(0, px(6)))
        for choice in question.choices:
            width = imgui.calc_text_size(choice.label).x + px(32)
            pressed = (
                main_button(choice.label, width) if choice.main else imgui.button(choice.label, ImVec2(width, px(32)))
            )
            if pressed:
                chosen = choice
            imgui.same_line()
        if imgui.is_key_pressed(imgui.Key.escape):
            chosen = question.choices[-1]
        if chosen is not None:
            imgui.close_current_popup()
    if chosen is not None:
        session.answer(chosen)
