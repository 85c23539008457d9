"""Use of the window without a pointer: Tab and arrows lead from control to control, F6 from one part of the window to
the next, and F10 to the menus; in the viewport, keys replace the pointer."""

from __future__ import annotations

from dataclasses import replace

from imgui_bundle import hello_imgui, imgui

from app.session.session import Session
from engine.scene.camera import Camera

__all__ = ["ARROWS", "Parts", "own_keys", "press_in_viewport", "set_up_imgui"]

Key = imgui.Key

ARROWS = {Key.left_arrow: (-1, 0), Key.right_arrow: (1, 0), Key.up_arrow: (0, 1), Key.down_arrow: (0, -1)}
"""Direction of each arrow key: x to the right, y up."""

PARTS = ("view", "inspector", "tools")
"""Parts of the window in the order in which F6 leads through them."""

APPEARED = 4
"""Frames after which all windows have appeared: each one that appears takes the keyboard focus."""

ZOOM = {Key.equal: 1.0, Key.keypad_add: 1.0, Key.minus: -1.0, Key.keypad_subtract: -1.0}
"""Steps of the wheel that each key counts as."""


class Parts:
    """Keeps track of which part of the window has the keyboard focus."""

    def __init__(self) -> None:
        self.current = "view"
        self._wanted: str | None = "view"

    def update(self) -> None:
        """Handles F6, and Shift+F6 to go back. Called once a frame, before the parts are drawn."""
        # Alt is held to look around with any tool; it must not take the keyboard focus away.
        imgui.internal.set_key_owner(Key.left_alt, imgui.get_id("look around"))
        imgui.internal.set_key_owner(Key.right_alt, imgui.get_id("look around"))
        for chord, way in ((Key.f6, 1), (Key.mod_shift | Key.f6, -1)):
            if imgui.is_key_chord_pressed(chord):
                self._wanted = PARTS[(PARTS.index(self.current) + way) % len(PARTS)]

    def begin(self, name: str) -> None:
        """Moves the keyboard focus to a part if it is its turn. Called at the beginning of the part's window."""
        if imgui.is_window_focused(imgui.FocusedFlags_.child_windows):
            self.current = name
        if self._wanted != name or imgui.get_frame_count() < APPEARED:
            return
        first = imgui.get_io().nav_visible or imgui.is_key_down(Key.f6)
        self._wanted, self.current = None, name
        imgui.set_window_focus()
        imgui.internal.nav_init_window(imgui.internal.get_current_window(), True)
        imgui.set_nav_cursor_visible(first)


def own_keys(*keys: Key) -> None:
    """Gives keys to the last item until the next frame, so that they do not lead to another item."""
    for key in keys:
        imgui.internal.set_key_owner(key, imgui.get_item_id())


def press_in_viewport(session: Session, camera: Camera, size: tuple[int, int], picking: bool) -> None:
    """Handles keys while the viewport, the last item, has the focus. `picking`: whether points are being clicked."""
    io, keyboard = imgui.get_io(), session.keyboard
    if not imgui.internal.test_key_owner(Key.space, 0):  # they move the pointer
        return
    own_keys(*ARROWS, Key.enter, Key.keypad_enter, Key.space)
    if session.throw.active or io.want_text_input:
        return
    for key, (x, y) in ARROWS.items():
        if imgui.is_key_pressed(key) and not io.key_alt:
            session.film.leave()
            keyboard.arrow(camera, x, y, io.key_shift, io.key_ctrl)
    for key, steps in ZOOM.items():
        if imgui.is_key_pressed(key) and not io.key_ctrl:
            middle = size[0] / 2, size[1] / 2
            eye = session.viewing.eye.zoomed(steps, middle, size, session.view_up, session.solid.radius)
            session.viewing = replace(session.viewing, eye=eye)
    if imgui.is_key_pressed(Key.enter, False) or imgui.is_key_pressed(Key.keypad_enter, False):
        keyboard.enter(camera)
    if keyboard.section is not None and not picking:
        own_keys(Key.escape)
        if imgui.is_key_pressed(Key.escape, False):
            keyboard.escape()


def set_up_imgui() -> None:
    """Applies the runner's default settings, and turns on keyboard navigation by Tab and arrows."""
    hello_imgui.imgui_default_settings.setup_default_imgui_config()
    imgui.get_io().config_flags |= imgui.ConfigFlags_.nav_enable_keyboard
