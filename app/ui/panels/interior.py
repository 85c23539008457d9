"""The inspector's section for the interior: families of planes with their pictures, and training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.jobs.results import result_folder
from app.jobs.training_job import Job, missing_for_training
from app.model.document import Training
from app.model.faces.words import CUT_NAMES, describe_guess
from app.session.question import Choice
from app.session.session import Session
from app.translation import _, ngettext
from app.ui.dialogs.file_dialogs import FileDialogs
from app.ui.panels.progress import curves, previews
from app.ui.panels.thumbnails import Thumbnails
from app.ui.theme import palette, px, u32
from app.ui.view.overlays import FAMILY_TITLES
from app.ui.view.viewport import Viewport
from app.ui.widgets import (
    clipped,
    disabled,
    eye_icon,
    heading,
    icon_button,
    int_slider,
    main_button,
    range_slider,
    row_label,
    secondary,
    segmented,
    text_field,
    tooltip,
)
from training.families import COUNTS, Family, Kind
from training.request import PriorName
from training.settings import DETAILS, DetailName

__all__ = ["InteriorPanel"]

DESCRIPTIONS: dict[Kind, str] = {
    "horizontal": _("Level cuts, as slices of an orange"),
    "radial": _("Cuts through the upright axis, as halves and wedges"),
    "parallel": _("Slices along one direction, as bread"),
    "custom": _("Planes that you chose one by one"),
}
RANGE_HINTS: dict[Kind, str] = {
    "horizontal": _("From which part of the height to which its planes stand. Double click: all of it"),
    "radial": _("From which part of a half turn to which its planes stand. Double click: all of it"),
    "parallel": _("From which part of the length to which its planes stand. Double click: all of it"),
}
AXIS_CHOICES = {_("longest side"): None, "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
DETAIL_NAMES: dict[DetailName, str] = {"draft": _("Draft"), "standard": _("Standard"), "high": _("High")}
DETAIL_HINTS = (_("A first look, in a minute"), _("For most objects"), _("Fine structures; takes longest"))
SAME_HINT = _(
    "One fruit, cut twice: then both pictures are followed exactly where their cuts meet. Leave it off for pictures of "
    "different fruits of a kind, or if you do not know."
)
PRIORS: dict[PriorName, str] = {"exemplar": _("From the pictures"), "stable-diffusion": _("From words, by diffusion")}


class InteriorPanel:
    """Draws the section and edits the document's families and training settings."""

    def __init__(self, session: Session, viewport: Viewport, thumbnails: Thumbnails, dialogs: FileDialogs) -> None:
        self.session, self.viewport, self.thumbnails, self.dialogs = session, viewport, thumbnails, dialogs
        self.open: Kind | None = None
        """The family whose settings are shown."""
        self.rows: dict[Kind, tuple[float, float]] = {}
        """Top and bottom of each family on the screen, to find the one that pictures are dropped on."""

    def dropped(self, paths: tuple[Path, ...], y: float) -> None:
        """Adds pictures that were dropped at this height of the screen to the family there."""
        kind = next((kind for kind, (low, high) in self.rows.items() if low <= y <= high), None)
        self.session.add_pictures(kind or self.open, paths)

    def show(self) -> None:
        """Draws one frame."""
        session = self.session
        heading(_("Interior"))
        self.rows.clear()
        for family in session.document.families:
            self._family(family)
        self._add()
        if session.document.families:
            self._settings()
            self._run()

    # Families

    def _family(self, family: Family) -> None:
        kind = family.kind
        imgui.push_id(kind)
        top = imgui.get_cursor_screen_pos().y
        start = imgui.get_cursor_screen_pos()
        width = imgui.get_content_region_avail().x
        side = px(54)
        self._thumbnail(family.exemplars[0] if family.exemplars else None, side)
        imgui.same_line(0, px(10))
        imgui.begin_group()
        imgui.dummy(ImVec2(0, px(1)))
        imgui.text_unformatted(FAMILY_TITLES[kind])
        count = len(family.custom) if kind == "custom" else family.count
        pictures = len(family.exemplars)
        shown = ngettext("{count} picture", "{count} pictures", pictures).format(count=pictures)
        shown = shown if pictures else _("no picture yet")
        planes = ngettext("{count} plane", "{count} planes", count).format(count=count)
        secondary(clipped(f"{planes}, {shown}", width - side - px(48)))
        imgui.end_group()
        after = imgui.get_cursor_screen_pos()
        imgui.set_cursor_screen_pos(ImVec2(start.x, start.y))
        imgui.set_next_item_allow_overlap()
        if imgui.invisible_button("row", ImVec2(width - px(34), side), imgui.ButtonFlags_.enable_nav):
            self.open = None if self.open == kind else kind
        tooltip(_("{description}. Click to change it.").format(description=DESCRIPTIONS[kind]))
        imgui.set_cursor_screen_pos(ImVec2(start.x + width - px(26), start.y + (side - px(26)) / 2))
        on = kind in self.viewport.show_families
        if icon_button(f"{eye_icon(on)}##planes", 26, quiet=True):
            self.viewport.show_families = self.viewport.show_families ^ {kind}
        tooltip(_("Show its planes on the object"))
        imgui.set_cursor_screen_pos(after)
        if self.open == kind:
            self._edit(family)
        self.rows[kind] = (top, imgui.get_cursor_screen_pos().y)
        imgui.pop_id()

    def _thumbnail(self, path: Path | None, side: float) -> None:
        p, draw = palette(), imgui.get_window_draw_list()
        low = imgui.get_cursor_screen_pos()
        high = ImVec2(low.x + side, low.y + side)
        texture = None if path is None else self.thumbnails.get(path)
        if texture is not None:
            draw.add_image_rounded(
                imgui.ImTextureRef(texture.glo), low, high, ImVec2(0, 0), ImVec2(1, 1), u32("#FFFFFF"), px(4)
            )
        else:
            draw.add_rect_filled(low, high, u32(p.field), px(4))
            broken = path is not None and self.thumbnails.is_none(path)
            symbol = icon.ICON_FA_TRIANGLE_EXCLAMATION if broken else icon.ICON_FA_IMAGE
            size = imgui.calc_text_size(symbol)
            at = ImVec2(low.x + (side - size.x) / 2, low.y + (side - size.y) / 2)
            draw.add_text(at, u32(p.trouble if broken else p.second), symbol)
        imgui.dummy(ImVec2(side, side))

    def _edit(self, family: Family) -> None:
        """Draws the settings of one family: number of planes, range, axis, prompt and pictures."""
        session, kind = self.session, family.kind
        imgui.indent(px(4))

        def change(name: str, new: Family, merge: str = "") -> None:
            session.change(name, session.document.with_family(new), merge)

        if kind != "custom":
            row_label(_("Planes"), 80)
            changed, count = int_slider("##count", family.count, 1, 2 * COUNTS[kind])
            if changed:
                change(_("Planes"), replace(family, count=max(1, count)), merge=f"count {kind}")
            row_label(_("Range"), 80)
            changed, span = range_slider("##range", family.span, RANGE_HINTS[kind])
            if changed:
                change(_("Range"), replace(family, span=span), merge=f"range {kind}")
        if kind == "parallel":
            row_label(_("Along"), 80)
            names = list(AXIS_CHOICES)
            axes = list(AXIS_CHOICES.values())
            current = axes.index(family.axis) if family.axis in axes else 0
            changed, index = imgui.combo("##axis", current, names)
            if changed:
                change(_("Axis"), replace(family, axis=axes[index]))
        row_label(_("In words"), 80)
        changed, text = text_field("##prompt", family.prompt, _("optional, if drawn from words"))
        if changed:
            change(_("Words"), replace(family, prompt=text), merge=f"prompt {kind}")
        self._pictures(family)
        if imgui.button(_("Remove family")):
            session.change(_("Remove {kind}").format(kind=FAMILY_TITLES[kind]), session.document.without_family(kind))
            self.open = None
        imgui.unindent(px(4))

    def _pictures(self, family: Family) -> None:
        session, side = self.session, px(46)
        for index, path in enumerate(family.exemplars):
            if index and imgui.get_content_region_avail().x > side:
                imgui.same_line()
            imgui.push_id(index)
            imgui.begin_group()
            at = imgui.get_cursor_screen_pos()
            self._thumbnail(path, side)
            imgui.set_cursor_screen_pos(at)
            imgui.set_next_item_allow_overlap()
            if imgui.invisible_button("picture", ImVec2(side, side), imgui.ButtonFlags_.enable_nav):
                session.faces.edit(family.kind, path)
            hovered = imgui.is_item_hovered(imgui.HoveredFlags_.allow_when_overlapped_by_item)
            deleted = imgui.is_item_focused() and imgui.is_key_pressed(imgui.Key.delete)
            self._picture_state(path, at, side)
            self._move_menu(family, path)
            imgui.set_cursor_screen_pos(ImVec2(at.x + side - px(18), at.y + px(2)))
            pressed = hovered and imgui.small_button(f"{icon.ICON_FA_XMARK}")
            pressed = pressed or deleted
            imgui.set_cursor_screen_pos(at)  # not at the end, which may be a fraction of a pixel outside the group
            imgui.end_group()
            imgui.pop_id()
            if pressed:
                session.change(_("Remove picture"), session.document.without_exemplar(family.kind, path))
                return
            imgui.same_line()
        if icon_button(f"{icon.ICON_FA_PLUS}##add", 46):
            self.dialogs.open_pictures(lambda paths: session.add_pictures(family.kind, paths))
        tooltip(_("Add a picture of a cut face"))
        for path in family.exemplars:
            face = session.faces.finder.get(path)
            if face is not None and face.problem and family.marks_of(path).outline is None:
                secondary(f"{path.name}: {face.verdict}.", wrap=True)

    def _picture_state(self, path: Path, at: ImVec2, side: float) -> None:
        """Adds a tooltip that says what the picture, the last item, seems to show, and a warning sign if it shows no
        face."""
        face = self.session.faces.finder.get(path)
        family = self.session.document.family(self.open) if self.open is not None else None
        corrected = family is not None and family.marks_of(path).outline is not None
        lines = [path.name]
        if face is None:
            lines.append(_("Looking for the cut face..."))
        elif corrected:
            lines.append(_("With the outline that you corrected."))
        elif face.problem:
            lines.append(f"{face.problem[:1].upper()}{face.problem[1:]}.")
            low, p = ImVec2(at.x + px(2), at.y + side - px(20)), palette()
            draw = imgui.get_window_draw_list()
            draw.add_rect_filled(low, ImVec2(low.x + px(20), low.y + px(18)), u32(p.panel, 0.8), px(4))
            draw.add_text(ImVec2(low.x + px(3), low.y + px(1)), u32(p.trouble), icon.ICON_FA_TRIANGLE_EXCLAMATION)
        elif face.guess is not None:
            lines.append(_("It {guess}.").format(guess=describe_guess(face.guess)))
            if face.note:
                lines.append(f"{face.note[:1].upper()}{face.note[1:]}.")
        lines.append(_("Click to see where it goes and to correct its outline; right click to move it."))
        tooltip("\n".join(lines))

    def _move_menu(self, family: Family, path: Path) -> None:
        session = self.session
        if not imgui.begin_popup_context_item("move"):
            return
        for kind in get_args(Kind):
            if kind not in (family.kind, "custom") and imgui.menu_item_simple(
                _("It shows {cut}").format(cut=CUT_NAMES[kind])
            ):
                session.change(_("Move picture"), session.document.moved_exemplar(path, family.kind, kind))
        imgui.end_popup()

    def _add(self) -> None:
        session = self.session
        stacks: tuple[Kind, ...] = ("horizontal", "radial", "parallel")
        missing = [kind for kind in stacks if session.document.family(kind) is None]
        if imgui.button(
            f"{icon.ICON_FA_IMAGE}  " + _("Drop or choose pictures"), ImVec2(-px(42) if missing else -1, 0)
        ):
            self.dialogs.open_pictures(lambda paths: session.add_pictures(self.open, paths))
        tooltip(_("Photographs of cut faces: 1 to 6 for each family"))
        if not missing:
            return
        imgui.same_line()
        if imgui.button(icon.ICON_FA_PLUS, ImVec2(px(34), 0)):
            imgui.open_popup("families")
        tooltip(_("Add a family of cuts"))
        if imgui.begin_popup("families"):
            for kind in missing:
                if imgui.menu_item_simple(f"{FAMILY_TITLES[kind]}##new"):
                    added = session.document.with_family(Family(kind, COUNTS[kind]))
                    session.change(_("Add {kind}").format(kind=FAMILY_TITLES[kind]), added)
                    self.open = kind
                tooltip(DESCRIPTIONS[kind])
            imgui.end_popup()

    # Training

    def _settings(self) -> None:
        session = self.session
        training, names = session.document.training, list(DETAILS)
        with disabled(session.training.busy):
            width = imgui.get_content_region_avail().x
            current = names.index(training.detail)
            chosen = segmented("detail", [DETAIL_NAMES[name] for name in names], current, width, DETAIL_HINTS)
            if chosen != current:
                detail: DetailName = names[chosen]
                self._change_training(_("Detail"), replace(training, detail=detail))
            if sum(bool(family.exemplars) for family in session.document.families) > 1 and training.prior == "exemplar":
                changed, same = imgui.checkbox(_("The pictures are of one and the same thing"), training.same)
                if changed:
                    self._change_training(_("One thing"), replace(training, same=same))
                tooltip(SAME_HINT)
            if imgui.tree_node_ex(_("More"), imgui.TreeNodeFlags_.span_avail_width):
                self._more(training)
                imgui.tree_pop()

    def _more(self, training: Training) -> None:
        session = self.session
        row_label(_("Drawn"), 84)
        names = list(PRIORS)
        current = names.index(training.prior) if training.prior in names else 0
        changed, index = imgui.combo("##prior", current, list(PRIORS.values()))
        if changed:
            self._change_training(_("Drawn"), replace(training, prior=names[index]))
        if training.prior == "stable-diffusion":
            row_label(_("Model"), 84)
            if imgui.button(training.model.name if training.model else _("Choose a folder..."), ImVec2(-1, 0)):
                self.dialogs.choose_folder(
                    _("Folder of a Stable Diffusion depth model"),
                    Path.home(),
                    lambda path: self._change_training(_("Model"), replace(training, model=path)),
                )
            row_label(_("Object"), 84)
            changed, thing = text_field("##thing", training.thing, _("watermelon"))
            if changed:
                self._change_training(_("Object"), replace(training, thing=thing), merge="thing")
            tooltip(_("What it is, in a word or two"))
        row_label(_("Seed"), 84)
        changed, seed = imgui.input_int("##seed", training.seed)
        if changed:
            self._change_training(_("Seed"), replace(training, seed=min(max(0, seed), 2**31 - 1)), merge="seed")
        tooltip(_("The same seed gives the same inside"))
        row_label(_("Iterations"), 84)
        usual = 0 if training.prior == "exemplar" else DETAILS[training.detail].iterations
        most = usual if training.iterations is None else training.iterations
        changed, most = imgui.input_int("##iterations", most, 10)
        if changed:
            self._change_training(
                _("Iterations"), replace(training, iterations=min(max(0, most), 100_000)), merge="most"
            )
        tooltip(_("At most; training ends sooner where it has settled"))
        row_label(_("Result"), 84)
        out = result_folder(session.document)
        if imgui.button(out.name if out else "-", ImVec2(-1, 0)) and out is not None:
            self.dialogs.choose_folder(
                _("Folder for the result"),
                out.parent,
                lambda path: self._change_training(_("Result"), replace(training, out=path)),
            )
        tooltip(_("{out}\nClick to choose another folder.").format(out=out) if out else "")

    def _change_training(self, name: str, training: Training, merge: str = "") -> None:
        self.session.change(name, replace(self.session.document, training=training), merge)

    def _run(self) -> None:
        """Draws the button for training, or the details of a job; the job's progress is in `app.ui.panels.footer`."""
        session, training = self.session, self.session.training
        job = training.job
        if job is not None:
            self._details(job)
            return
        missing = missing_for_training(session.document) if session.object is not None else _("Open an object first.")
        trained = session.object is not None and session.object.trained
        with disabled(bool(missing)):
            if trained and imgui.button(f"{icon.ICON_FA_ARROWS_ROTATE}  " + _("Train again"), ImVec2(-1, px(32))):
                self._confirm_restart()
            elif not trained and main_button(f"{icon.ICON_FA_PLAY}  " + _("Give it an inside")):
                training.start()
        if missing:
            secondary(missing, wrap=True)

    def _confirm_restart(self) -> None:
        """Asks for confirmation: the new result replaces the one that is shown."""
        session = self.session
        session.ask(
            _("Train again"),
            _("The new inside takes the place of the one that is shown."),
            Choice(_("Train again"), session.training.start, main=True),
        )

    def _details(self, job: Job) -> None:
        progress = job.progress
        if job.phase == "failed":
            for line in job.log_tail()[-3:]:
                secondary(line, wrap=True)
        if len(progress.section) > 1:
            curves(progress)
        if progress.previews:
            previews(progress, self.thumbnails)
