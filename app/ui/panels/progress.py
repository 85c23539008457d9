"""Progress of training: loss curves, and labels beside the object's present cut faces."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui, implot

from app.jobs.job_events import Progress
from app.translation import _
from app.ui.panels.thumbnails import Thumbnails
from app.ui.theme import palette, px, rgba, u32
from app.ui.widgets import secondary, tooltip

__all__ = ["curves", "previews"]

SHORTEST = 10
"""Least number of iterations on the curves' axis. Later the axis ends at the last iteration, not at the planned one,
since training may converge much earlier."""


def curves(progress: Progress) -> None:
    """Plots the losses so far."""
    p = palette()
    flags = implot.Flags_.no_inputs | implot.Flags_.no_menus | implot.Flags_.no_mouse_text | implot.Flags_.no_title
    if not implot.begin_plot("##loss", ImVec2(-1, px(132)), flags | implot.Flags_.no_frame):
        return
    plain = implot.AxisFlags_.no_label | implot.AxisFlags_.no_tick_marks
    implot.setup_axes("", "", plain | implot.AxisFlags_.no_tick_labels | implot.AxisFlags_.no_grid_lines, plain)
    losses = np.array([*progress.section, *progress.surface])
    losses = losses[np.isfinite(losses)]
    low, high = (float(losses.min()), float(losses.max())) if len(losses) else (0.0, 1.0)
    margin = 0.1 * max(high - low, 1e-3)
    last = max(len(progress.section), SHORTEST)
    implot.setup_axes_limits(1, last, max(0.0, low - margin), high + margin, implot.Cond_.always)
    implot.setup_axis_format(implot.ImAxis_.y1, "%.2f")
    beside = implot.LegendFlags_.no_buttons | implot.LegendFlags_.outside | implot.LegendFlags_.horizontal
    implot.setup_legend(implot.Location_.north_west, beside)
    for name, values, colour in (
        (_("cut faces"), progress.section, p.accent),
        (_("surface"), progress.surface, p.curve),
    ):
        ys = np.asarray(values, np.float64)
        spec = implot.Spec(line_color=rgba(colour), line_weight=px(1.6))
        implot.plot_line(name, np.arange(1.0, len(ys) + 1), ys, spec)
    implot.end_plot()


def previews(progress: Progress, thumbnails: Thumbnails) -> None:
    """Draws the latest labels, each beside the object's cut face in the same plane."""
    secondary(_("Wanted and reached"))
    width = (imgui.get_content_region_avail().x - px(8)) / 2
    for index, path in enumerate(progress.previews[:4]):
        texture = thumbnails.get(path)
        if texture is None:
            continue
        if index % 2:
            imgui.same_line()
        height = width * texture.height / max(texture.width, 1)
        low = imgui.get_cursor_screen_pos()
        imgui.get_window_draw_list().add_image_rounded(
            imgui.ImTextureRef(texture.glo),
            low,
            ImVec2(low.x + width, low.y + height),
            ImVec2(0, 0),
            ImVec2(1, 1),
            u32("#FFFFFF"),
            px(4),
        )
        imgui.dummy(ImVec2(width, height))
        tooltip(
            _("Left: what the picture wants. Right: what the object shows ({split}).").format(
                split=path.stem.split("_")[0]
            )
        )
