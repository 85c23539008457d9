"""Fields of the window, in ImGui's own input without a window: what is typed stays in range."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from imgui_bundle import ImVec2, imgui

from app.ui.widgets import float_slider, text_field
from engine.io.fields import LONGEST_TEXT


@pytest.fixture
def frames() -> Iterator[None]:
    """A context of ImGui."""
    context = imgui.create_context()
    io = imgui.get_io()
    io.set_ini_filename("")  # writes no file
    io.display_size, io.delta_time = ImVec2(800, 600), 1 / 60
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
    yield
    imgui.destroy_context(context)


class Slider:
    """A slider over the range from 0 to 1, and its value."""

    def __init__(self) -> None:
        self.value, self.middle = 0.25, (0.0, 0.0)

    def frame(self) -> None:
        imgui.new_frame()
        imgui.set_next_window_pos(ImVec2(0, 0))
        imgui.begin("window")
        imgui.set_cursor_pos(ImVec2(50, 50))
        low = imgui.get_cursor_screen_pos()
        self.middle = low.x + 20, low.y + 6
        self.value = float_slider("##value", self.value, 0.0, 1.0, "", 300)[1]
        imgui.end()
        imgui.end_frame()

    def typed(self, text: str) -> float:
        io = imgui.get_io()
        self.frame()
        io.add_mouse_pos_event(*self.middle)
        self.frame()
        io.add_key_event(imgui.Key.mod_ctrl, True)
        for down in (True, False):
            io.add_mouse_button_event(0, down)
            self.frame()
        io.add_key_event(imgui.Key.mod_ctrl, False)
        self.frame()
        io.add_input_characters_utf8(text)
        self.frame()
        for down in (True, False):
            io.add_key_event(imgui.Key.enter, down)
            self.frame()
        return self.value


@pytest.mark.usefixtures("frames")
@pytest.mark.parametrize(("text", "taken"), [("0.75", 0.75), ("5", 1.0), ("-3", 0.0), ("1e400", 1.0), ("nan", None)])
def test_a_number_that_is_typed_stays_in_the_range_of_its_slider(text: str, taken: float | None) -> None:
    value = Slider().typed(text)
    assert value == pytest.approx(taken) if taken is not None else 0 <= value <= 1


@pytest.mark.usefixtures("frames")
def test_a_text_is_no_longer_than_a_project_may_hold() -> None:
    imgui.new_frame()
    imgui.begin("window")
    _, text = text_field("##text", "a" * (LONGEST_TEXT + 5))
    imgui.end()
    imgui.end_frame()
    assert len(text) == LONGEST_TEXT
