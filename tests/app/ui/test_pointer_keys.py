"""The pointer moved by keys, in ImGui's own input without a window: as a mouse would move and press it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from imgui_bundle import ImVec2, imgui

from app.ui.pointer_keys import PointerKeys

Key = imgui.Key


class Screen:
    """Frames of an interface that has nothing but the pointer."""

    def __init__(self) -> None:
        self.warped: list[tuple[float, float]] = []
        self.pointer = PointerKeys(lambda x, y: self.warped.append((x, y)))

    def frames(self, count: int = 2) -> None:
        for _ in range(count):
            imgui.new_frame()
            self.pointer.update()
            imgui.end_frame()

    def hold(self, key: Key, count: int) -> None:
        imgui.get_io().add_key_event(key, True)
        self.frames(count)
        imgui.get_io().add_key_event(key, False)
        self.frames()

    @property
    def at(self) -> tuple[float, float]:
        return imgui.get_io().mouse_pos.x, imgui.get_io().mouse_pos.y

    @property
    def down(self) -> bool:
        return imgui.is_mouse_down(imgui.MouseButton_.left)


@pytest.fixture
def screen() -> Iterator[Screen]:
    context = imgui.create_context()
    io = imgui.get_io()
    io.set_ini_filename("")  # writes no file
    io.display_size, io.delta_time = ImVec2(800, 600), 1 / 60
    io.backend_flags |= imgui.BackendFlags_.renderer_has_textures
    io.add_mouse_pos_event(400, 300)
    made = Screen()
    made.pointer.toggle()
    made.frames()
    yield made
    imgui.destroy_context(context)


def test_arrows_move_it_faster_and_faster_and_not_out_of_the_window(screen: Screen) -> None:
    screen.hold(Key.right_arrow, 3)
    short = screen.at[0] - 400
    assert 1 <= short < 15 and screen.at[1] == 300
    screen.hold(Key.up_arrow, 30)
    assert screen.at[1] < 300 - 4 * short
    screen.hold(Key.left_arrow, 200)
    assert screen.at[0] == 0
    assert screen.warped[-1] == pytest.approx(screen.at)
    assert not screen.pointer.moving and not screen.down


def test_control_moves_it_by_single_pixels(screen: Screen) -> None:
    imgui.get_io().add_key_event(Key.mod_ctrl, True)
    screen.frames()
    screen.hold(Key.down_arrow, 4)
    assert screen.at == (400, 301)


def test_space_clicks_and_enter_holds(screen: Screen) -> None:
    imgui.get_io().add_key_event(Key.space, True)
    screen.frames()
    assert screen.down
    imgui.get_io().add_key_event(Key.space, False)
    screen.frames()
    assert not screen.down
    screen.hold(Key.enter, 2)
    screen.hold(Key.right_arrow, 10)
    assert screen.down and screen.at[0] > 400  # a drag
    screen.hold(Key.enter, 2)
    assert not screen.down


def test_escape_lets_go_first_and_then_ends_it(screen: Screen) -> None:
    screen.hold(Key.enter, 2)
    screen.hold(Key.escape, 2)
    assert not screen.down and screen.pointer.on
    screen.hold(Key.escape, 2)
    assert not screen.pointer.on
    screen.hold(Key.right_arrow, 5)
    assert screen.at == (400, 300)


def test_what_it_uses_reaches_nothing_else(screen: Screen) -> None:
    for key in (Key.right_arrow, Key.space, Key.enter):
        imgui.get_io().add_key_event(key, True)
        imgui.new_frame()
        screen.pointer.update()
        assert not imgui.is_key_pressed(key) and not imgui.internal.test_key_owner(key, 0)
        imgui.end_frame()
        imgui.get_io().add_key_event(key, False)
        screen.frames()
    screen.pointer.toggle()
    screen.frames()
    imgui.get_io().add_key_event(Key.right_arrow, True)
    imgui.new_frame()
    screen.pointer.update()
    assert imgui.is_key_pressed(Key.right_arrow)
    imgui.end_frame()
