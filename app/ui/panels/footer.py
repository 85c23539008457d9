"""The lower end of the inspector, which does not scroll: progress of films, loading and training, with controls."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.jobs.film.film_job import FilmJob
from app.jobs.scene_loader import SceneLoader
from app.jobs.training_job import Job
from app.session.session import Session
from app.translation import _
from app.ui.theme import px
from app.ui.widgets import disabled, format_duration, main_button, right_text, secondary, thin_bar, tooltip

__all__ = ["Footer"]

PHASES = {"paused": _("Paused"), "stopping": _("Stopping"), "stopped": _("Stopped"), "failed": _("Ended early")}


class Footer:
    """Draws the work in the background, as tall as necessary."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.height = 0.0
        """Height in the last frame, including the space above it, pixels."""

    def show(self) -> None:
        """Draws one frame, from the cursor down."""
        session, top = self.session, imgui.get_cursor_pos_y()
        loader, job = session.loader, session.training.job
        film = session.film.job
        if loader is not None or job is not None or film is not None:
            imgui.separator()
        if film is not None:
            self._saving(film)
        if loader is not None:
            self._preparing(loader)
        if job is not None:
            self._training(job)
        self.height = imgui.get_cursor_pos_y() - top

    def _saving(self, film: FilmJob) -> None:
        thin_bar(film.fraction)
        imgui.align_text_to_frame_padding()
        secondary(
            _("Stopping the film")
            if film.cancelled
            else _("Saving {name}, {fraction:.0%}").format(name=film.out.name, fraction=film.fraction)
        )
        imgui.same_line(imgui.get_content_region_avail().x - px(56))
        if imgui.button(_("Cancel") + "##film", ImVec2(px(68), 0)):
            self.session.film.cancel()

    def _preparing(self, loader: SceneLoader) -> None:
        thin_bar(loader.fraction)
        imgui.align_text_to_frame_padding()
        secondary(loader.stage)
        imgui.same_line(imgui.get_content_region_avail().x - px(56))
        if imgui.button(_("Cancel") + "##preparing", ImVec2(px(68), 0)):
            self.session.scene.cancel()

    def _training(self, job: Job) -> None:
        progress, phase = job.progress, job.phase
        thin_bar(progress.fraction, paused=phase != "running")
        if phase == "running":
            detail = f" {progress.iteration} / {progress.iterations}" if progress.stage == "train" else ""
            secondary(f"{progress.title}{detail}")
            if progress.remaining is not None:
                right_text(_("{time} left").format(time=format_duration(progress.remaining)))
        else:
            secondary(PHASES.get(phase, _("Done")))
        training, square = self.session.training, px(32)
        full = imgui.get_content_region_avail().x
        if phase in ("running", "paused", "stopping"):
            label = (
                f"{icon.ICON_FA_PLAY}  " + _("Go on") if phase == "paused" else f"{icon.ICON_FA_PAUSE}  " + _("Pause")
            )
            with disabled(phase == "stopping"):
                if main_button(label, full - square - px(8)):
                    training.toggle_pause()
                imgui.same_line()
                if imgui.button(f"{icon.ICON_FA_STOP}##stop", ImVec2(square, square)):
                    training.stop()
            tooltip(_("Stop. What was done is kept and can be resumed."))
            return
        if main_button(f"{icon.ICON_FA_PLAY}  " + _("Resume"), full - px(108)):
            training.resume()
        imgui.same_line()
        if imgui.button(_("Start again"), ImVec2(px(100), square)):
            training.start()
