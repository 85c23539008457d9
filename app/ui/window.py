"""The window: runs a session in hello_imgui, with the GL renderer in the window's context."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import glfw
import moderngl
from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, imguizmo, implot
from imgui_bundle import icons_fontawesome_6 as icon
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

from app.jobs.scene_loader import SceneLoader
from app.jobs.training_job import Job
from app.model.autosave import UnsavedWork, find_unsaved_work
from app.model.project import Viewing
from app.model.settings import settings_folder
from app.session.recovered_jobs import describe_job, dismiss_job, recovered_jobs
from app.session.session import Session
from app.translation import _
from app.ui.commands import press_shortcuts
from app.ui.dialogs.export_window import ExportWindow
from app.ui.dialogs.exporter import Exporter
from app.ui.dialogs.file_dialogs import FileDialogs
from app.ui.dialogs.question import show_question
from app.ui.film.film_window import FilmWindow
from app.ui.film.timeline import TimelinePanel
from app.ui.keyboard import ARROWS, Parts, set_up_imgui
from app.ui.menus import Menus
from app.ui.panels.face_editor import FaceEditor
from app.ui.panels.inspector import Inspector
from app.ui.panels.interior import InteriorPanel
from app.ui.panels.measures import MeasuresPanel
from app.ui.panels.recent import RecentFiles
from app.ui.panels.thumbnails import Thumbnails
from app.ui.pointer_keys import PointerKeys, warp_in
from app.ui.theme import Fonts, apply, load_fonts, palette, px, u32
from app.ui.toolbar import Toolbar
from app.ui.view.painter import Painter
from app.ui.view.slices import SliceViews, is_shown, quarters
from app.ui.view.viewport import Viewport
from app.ui.widgets import font, secondary, thin_bar
from engine.io.picture_file import PICTURE_SUFFIXES

__all__ = ["Window"]

IDLE_FRAMES = 6.0
"""Frames per second while nothing happens: enough to follow a job."""

WAITING_FRAMES = 12.0
"""Frames per second while the window waits for work in the background: results are shown soon."""

ACTIVE, WAITING_ACTIVE = 3.0, 0.1
"""Seconds after the last event before fewer frames are drawn, in general and while the window waits for background
work; the latter is as long as a menu needs to open."""

WIDEST = 0.55
"""Largest part of the window for the inspector, however large the interface is."""

INSPECTOR = 344.0
"""Width of the inspector at 96 DPI; it stays the same when the window grows."""

READ_IN = 12.0
"""Seconds until a message leaves the status line: it is about the last action, not about what is shown."""

GUI_ERRORS = 3
"""Consecutive frames with an error after which the window gives up, rather than show the error for ever."""


class Window:
    """Builds the panels once the OpenGL context exists, and draws them."""

    def __init__(self, session: Session, start: Callable[[Session], None] | None = None) -> None:
        self.session = session
        self.start = start
        self.parts = Parts()
        self.dropped: list[Path] = []
        self.unsaved: list[UnsavedWork] = []
        self.recovered_jobs: list[Job] = []
        """Jobs of earlier sessions that the user has not been told about yet."""
        self.params = self._params()
        self._failures = 0
        self._title = ""
        self._said, self._said_at = "", 0.0
        """The last message in the status line, and when it appeared."""

    def run(self) -> None:
        """Shows the window until it is closed."""
        hello_imgui.run(self.params)

    def _params(self) -> hello_imgui.RunnerParams:
        params = hello_imgui.RunnerParams()
        settings = self.session.settings
        params.app_window_params.window_title = "FruitNinja"
        params.app_window_params.window_geometry.size = settings.window
        params.renderer_backend_options.open_gl_options.anti_aliasing_samples = 0
        windows = params.imgui_window_params
        windows.default_imgui_window_type = hello_imgui.DefaultImGuiWindowType.provide_full_screen_dock_space
        windows.show_menu_bar = True
        windows.show_menu_app = False
        windows.show_menu_view = False
        windows.show_status_bar = True
        windows.show_status_fps = False
        windows.remember_theme = windows.remember_status_bar_settings = False
        params.ini_folder_type = hello_imgui.IniFolderType.absolute_path
        params.ini_filename = str(settings_folder() / "window.ini")
        params.fps_idling.fps_idle = IDLE_FRAMES
        callbacks = params.callbacks
        callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
        callbacks.load_additional_fonts = load_fonts
        callbacks.setup_imgui_style = lambda: apply(settings.theme, settings.scale, scaled_later=True)
        callbacks.setup_imgui_config = set_up_imgui
        callbacks.post_init = self._begin
        callbacks.before_exit = self._end
        callbacks.pre_new_frame = self._tick
        callbacks.show_gui = lambda: self._guard(self._gui)
        callbacks.show_menus = lambda: self._guard(self.menus.show)
        callbacks.show_status = self._status
        toolbar = hello_imgui.EdgeToolbar()
        toolbar.show_toolbar = self._tools
        toolbar.options = hello_imgui.EdgeToolbarOptions(size_em=4.0, window_padding_em=ImVec2(0.72, 0.75))
        callbacks.edges_toolbars = {hello_imgui.EdgeToolbarType.left: toolbar}
        params.docking_params = self._docking()
        return params

    def _docking(self) -> hello_imgui.DockingParams:
        docking = hello_imgui.DockingParams()
        quiet = imgui.internal.DockNodeFlagsPrivate_.no_tab_bar
        docking.main_dock_space_node_flags = quiet | imgui.DockNodeFlags_.passthru_central_node
        docking.docking_splits = [self._split()]
        view = hello_imgui.DockableWindow("Object", "MainDockSpace", self._viewport, can_be_closed_=False)
        view.call_begin_end = False
        panel = hello_imgui.DockableWindow("Inspector", "Inspector", self._inspector, can_be_closed_=False)
        docking.dockable_windows = [view, panel]
        return docking

    def _split(self) -> hello_imgui.DockingSplit:
        """Where the inspector begins at this scale of the interface; the user can drag its edge."""
        self._scale, width = self.session.settings.scale, self.session.settings.window[0]
        part = min(INSPECTOR * self._scale / width, WIDEST)
        split = hello_imgui.DockingSplit("MainDockSpace", "Inspector", imgui.Dir.right, part)
        split.node_flags = imgui.internal.DockNodeFlagsPrivate_.no_tab_bar
        return split

    # Life cycle

    def _begin(self) -> None:
        self.ctx = moderngl.create_context(require=330)
        self.painter = Painter(self.ctx, glfw.post_empty_event)
        self.thumbnails = Thumbnails(self.ctx)
        self.recent = RecentFiles(self.session, self.painter, self.ctx)
        self.dialogs = FileDialogs(self.session.folder)
        self.viewport = Viewport(self.session, self.painter)
        self.slices = SliceViews(self.session, self.ctx)
        self.face_editor = FaceEditor(self.session, self.painter)
        self.exporter = Exporter(self.session, self.painter)
        self.export = ExportWindow(self.exporter, self.dialogs)
        self.film_window = FilmWindow(self.session, self.dialogs)
        self.timeline = TimelinePanel(self.session, self.film_window)
        self.interior = InteriorPanel(self.session, self.viewport, self.thumbnails, self.dialogs)
        self.measures = MeasuresPanel(self.session, self.slices)
        self.inspector = Inspector(self.session, self.interior, self.measures)
        self.window = glfw_window_hello_imgui()
        self.pointer = PointerKeys(warp_in(self.window))
        self.menus = Menus(
            self.session,
            self.viewport,
            self.slices,
            self.dialogs,
            self.export,
            self.film_window,
            self.inspector,
            self.pointer,
        )
        self.toolbar = Toolbar(self.session, self.viewport, self.export, self.menus.toggle_slices)
        if implot.get_current_context() is None:
            implot.create_context()
        glfw.set_drop_callback(self.window, self._on_drop)
        if self.start is not None:
            self.start(self.session)
        self.unsaved = find_unsaved_work()
        self.recovered_jobs = recovered_jobs(self.session)

    def _end(self) -> None:
        one = px(1) / self.session.settings.scale
        width, height = (max(200, round(side / one)) for side in glfw.get_window_size(self.window))
        self.session.change_settings(replace(self.session.settings, window=(width, height)))  # at 96 DPI
        glfw.set_drop_callback(self.window, None)  # type: ignore[arg-type]
        self.session.faces.release()
        self.face_editor.release()
        self.slices.release()
        self.measures.measurer.close()
        self.thumbnails.release()
        self.recent.release()
        self.painter.release()

    def _tick(self) -> None:
        session = self.session
        try:
            session.tick()
        except Exception as error:  # background work that fails must not end the window
            session.show_failure(error)
        if self.dropped:
            self._open_dropped()
        if session.settings.scale != self._scale:
            self.params.docking_params.docking_splits = [self._split()]
            self.params.docking_params.layout_reset = True
        self._set_pace()
        if not (self.viewport.moving or self.painter.unfinished) and session.faces.open_face is None:
            self.recent.keep()
        title = f"{session.title} - FruitNinja" if session.document.scene else "FruitNinja"
        if title != self._title:
            glfw.set_window_title(self.window, title)  # under X11 each call is an event that causes another frame
            self._title = title
        if (glfw.window_should_close(self.window) or self.params.app_shall_exit) and not session.closing:
            glfw.set_window_should_close(self.window, False)
            self.params.app_shall_exit = False
            if session.question is None:
                session.files.close()
        if session.closing:
            self.params.app_shall_exit = True

    def _set_pace(self) -> None:
        """Sets how often frames are drawn: as often as possible while something moves, rarely while the window waits
        for background work, which needs the processor, and even more rarely while nothing happens."""
        session, idling = self.session, self.params.fps_idling
        waits = (
            session.loader is not None
            or session.faces.busy
            or self.exporter.busy
            or self.measures.measurer.busy
            or self.painter.only_reads
        )
        drawing = self.painter.unfinished and not self.painter.only_reads
        follows = self.slices.busy or session.isolation.pending  # what the user drags is read within moments
        idling.enable_idling = not (self.viewport.moving or follows or drawing or self.pointer.moving)
        idling.time_active_after_last_event = WAITING_ACTIVE if waits else ACTIVE
        idling.fps_idle = WAITING_FRAMES if waits else IDLE_FRAMES

    def _on_drop(self, _: Any, names: Any, *__: Any) -> None:
        self.dropped += [Path(name) for name in names]

    def _open_dropped(self) -> None:
        paths, self.dropped = tuple(self.dropped), []
        pictures = tuple(path for path in paths if path.suffix.lower() in PICTURE_SUFFIXES)
        if pictures and self.session.document.scene is not None:
            self.interior.dropped(pictures, imgui.get_io().mouse_pos.y)
        elif paths and not pictures:
            self.session.files.open(paths[0])
        else:
            self.session.notify(_("Open an object first, then drop pictures of its cut faces."))

    def _guard(self, draw: Callable[[], None]) -> None:
        """Calls `draw` and shows its error, if any; restores ImGui's stacks so that the frame can end."""
        state = imgui.internal.ErrorRecoveryState()
        imgui.internal.error_recovery_store_state(state)
        try:
            draw()
            self._failures = 0
        except Exception as error:
            self._failures += 1
            if self._failures > GUI_ERRORS:
                raise
            imgui.internal.error_recovery_try_to_recover_state(state)
            self.session.show_failure(error)

    # Drawing

    def _gui(self) -> None:
        imguizmo.im_guizmo.begin_frame()  # otherwise handles ignore the pointer
        self.pointer.update()
        self.parts.update()
        held = any(imgui.is_key_down(key) for key in ARROWS)
        if not imgui.is_any_item_active() and not imguizmo.im_guizmo.is_using_any() and not held:
            self.session.history.settle()  # a drag has ended
        self.viewport.game_keys()
        controls = imgui.get_io().nav_visible and imgui.is_any_item_focused() and not self.viewport.focused
        press_shortcuts(self.menus.commands, pressing=controls)
        self.menus.show_shortcuts()
        self.export.show()
        self.film_window.show()
        self.menus.slices.show()
        self.dialogs.show()
        show_question(self.session)

    def _viewport(self) -> None:
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(0, 0))
        flags = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
        imgui.begin("Object", None, flags | imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_title_bar)
        imgui.pop_style_var()
        self.parts.begin("view")
        self._guard(self._object_or_picture)
        self._guard(self._viewport_body)
        imgui.end()

    def _object_or_picture(self) -> None:
        if self.face_editor.show():
            return
        at, below = imgui.get_cursor_screen_pos(), self.timeline.height
        available = imgui.get_content_region_avail()
        if below:
            imgui.set_cursor_screen_pos(ImVec2(at.x, at.y + available.y - below))
            self.timeline.show(available.x)
        size = available.x, available.y - below
        places = [(at, (int(size[0]), int(size[1])))]
        self.viewport.sliced = ()
        if is_shown(self.session):
            places = quarters(at, size)
            self.slices.show(places[1:])
            self.viewport.sliced = self.slices.slices().planes
        imgui.set_cursor_screen_pos(at)
        flags = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
        if len(places) > 1 or below:
            imgui.begin_child("##3d", ImVec2(*places[0][1]), imgui.ChildFlags_.nav_flattened, flags)
            self.viewport.show()
            imgui.end_child()
        else:
            self.viewport.show()

    def _viewport_body(self) -> None:
        self._notices()
        self.menus.context_menu()
        if self.session.document.scene is None:
            self.recent.show(
                self.viewport.origin,
                self.viewport.size,
                lambda: self.dialogs.open_scene(self.session.files.open),
                lambda: self.menus.open_sample("watermelon"),
            )
        elif self.session.object is None and self.session.loader is not None:
            self._opening(self.session.loader)

    def _inspector(self) -> None:
        self.parts.begin("inspector")
        self._guard(self.inspector.show)

    def _tools(self) -> None:
        self.parts.begin("tools")
        self._guard(self.toolbar.show)

    def _status(self) -> None:
        message, now = self.session.message, time.monotonic()
        if message is not self._said:
            self._said, self._said_at = message, now
        if now - self._said_at > READ_IN:
            message = ""
        if self.session.document.scene is None:
            message = message or _("Drop a capture on the window, or open one with Ctrl+O.")
        imgui.text_unformatted(message)

    def _opening(self, loader: SceneLoader) -> None:
        """Shows what is being opened while there is nothing of it to draw yet."""
        view, width = self.viewport, px(300)
        left = view.origin.x + (view.size[0] - width) / 2
        imgui.set_cursor_screen_pos(ImVec2(left, view.origin.y + view.size[1] / 2 - px(30)))
        imgui.begin_child("##opening", ImVec2(width, px(80)))
        with font(Fonts.bold):
            imgui.text_unformatted(loader.request.scene.name)
        thin_bar(loader.fraction)
        secondary(loader.stage)
        imgui.end_child()

    def _notices(self) -> None:
        """Draws cards at the bottom of the viewport: unsaved work, jobs of earlier sessions, hints, errors."""
        view, session = self.viewport, self.session
        texts: list[tuple[str, str, Callable[[], None] | None, Callable[[], None]]] = []
        if self.unsaved:
            first = self.unsaved[0]
            name = first.name or _("a project that was never saved")
            texts.append(
                (
                    _("Unsaved work on {name} was kept.").format(name=name),
                    _("Bring it back"),
                    self._recover,
                    self._discard,
                )
            )
        if self.recovered_jobs:
            texts.append((describe_job(self.recovered_jobs[0]), _("Show it"), self._show_job, self._dismiss_job))
        if session.faces.hint is not None and session.faces.open_face is None:
            hint = session.faces.hint
            look = partial(session.faces.edit, hint.kind, hint.path)
            texts.append((hint.text, _("Look at it"), look, session.faces.dismiss_hint))
        if session.error:
            texts.append((session.error, "", None, lambda: setattr(session, "error", "")))
        y = view.origin.y + view.size[1] - px(46)
        for text, label, act, dismiss in texts:
            y -= self._notice(text, label, act, dismiss, y) + px(8)

    def _notice(
        self, text: str, label: str, act: Callable[[], None] | None, dismiss: Callable[[], None], bottom: float
    ) -> float:
        """Draws one card; returns its height."""
        p, view = palette(), self.viewport
        draw = imgui.get_window_draw_list()
        inner = min(px(560), view.size[0] - px(56))
        wrap_width = inner - px(64) - (imgui.calc_text_size(label).x + px(34) if label else 0)
        size = imgui.calc_text_size(text, wrap_width=wrap_width)
        height = max(size.y, px(26)) + px(20)
        low = ImVec2(view.origin.x + (view.size[0] - inner) / 2, bottom - height)
        draw.add_rect_filled(low, ImVec2(low.x + inner, bottom), u32(p.panel, 0.97), px(6))
        draw.add_rect(low, ImVec2(low.x + inner, bottom), u32(p.trouble if not label else p.line), px(6), px(1))
        symbol = icon.ICON_FA_CIRCLE_INFO if label else icon.ICON_FA_TRIANGLE_EXCLAMATION
        draw.add_text(ImVec2(low.x + px(13), low.y + (height - imgui.get_font_size()) / 2), u32(p.trouble), symbol)
        imgui.set_cursor_screen_pos(ImVec2(low.x + px(40), low.y + (height - size.y) / 2))
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + wrap_width)
        imgui.text_unformatted(text)
        imgui.pop_text_wrap_pos()
        right = low.x + inner - px(34)
        middle = low.y + (height - imgui.get_frame_height()) / 2
        if label and act is not None:
            imgui.set_cursor_screen_pos(ImVec2(right - imgui.calc_text_size(label).x - px(26), middle))
            imgui.set_next_item_allow_overlap()
            if imgui.button(label):
                act()
        imgui.set_cursor_screen_pos(ImVec2(right, middle))
        imgui.set_next_item_allow_overlap()
        imgui.push_style_color(imgui.Col_.button, ImVec4(0, 0, 0, 0))
        if imgui.button(f"{icon.ICON_FA_XMARK}##dismiss{text[:20]}", ImVec2(px(28), 0)):
            dismiss()
        imgui.pop_style_color()
        return height

    def _recover(self) -> None:
        first = self.unsaved.pop(0)
        self.session.files.after_saving(lambda: self.session.files.recover(first))

    def _discard(self) -> None:
        self.unsaved.pop(0).discard()

    def _show_job(self) -> None:
        """Opens the document of a job of an earlier session."""
        session, job = self.session, self.recovered_jobs[0]

        def show() -> None:
            session.files.open_document(job.document, Viewing(mode="capture"))
            self._dismiss_job()

        session.files.after_saving(show)

    def _dismiss_job(self) -> None:
        dismiss_job(self.session, self.recovered_jobs.pop(0))
