"""Colours, fonts and distances of the window; the dark and the light theme define the same roles."""

from __future__ import annotations

from dataclasses import dataclass

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui, implot

__all__ = ["DARK", "LIGHT", "SCALES", "Palette", "apply", "load_fonts", "palette", "px", "u32"]

FONT_SIZE = 15.5
SMALL_SIZE = 13.5
"""Pixels at 96 DPI."""


@dataclass(frozen=True)
class Palette:
    """The colour of each role, '#RRGGBB'."""

    accent: str = "#FF6B4A"
    """The active tool, the main action, progress."""
    accent_hovered: str = "#FF8468"
    accent_pressed: str = "#FF9C85"
    """Has more contrast with its text than the accent itself."""
    on_accent: str = "#1B1C1E"
    ground: str = "#1B1C1E"
    panel: str = "#232528"
    field: str = "#303337"
    hover: str = "#3C3F44"
    pressed: str = "#474B51"
    text: str = "#E6E7E9"
    second: str = "#A6ABB3"
    """Secondary text."""
    line: str = "#34373C"
    view: str = "#1F2023"
    """Background of the object."""
    trouble: str = "#F2B84B"
    curve: str = "#7FA7D9"
    """The second curve of a plot, the second of three planes."""
    third: str = "#7CCB8F"
    """The third of three planes: it stands out from the flesh of most fruit."""
    marks: tuple[str, ...] = ("#F2B84B", "#7FA7D9", "#7CCB8F", "#EE9CBB", "#C9A8F0", "#62C9C9")
    """Colours of the marks of pieces, in the order of MARKS."""


DARK = Palette()
LIGHT = Palette(
    accent="#C93F1D",
    accent_hovered="#B33517",
    accent_pressed="#9C2C11",
    on_accent="#FFFFFF",
    ground="#E4E5E7",
    panel="#F4F4F5",
    field="#E3E5E8",
    hover="#D5D8DC",
    pressed="#C6CACF",
    text="#1F2124",
    second="#565B62",
    line="#D3D6DA",
    view="#ECEDEF",
    trouble="#8A5600",
    curve="#2F6DB5",
    third="#1A7340",
    marks=("#8A5600", "#2F6DB5", "#1A7340", "#A8326A", "#6B3FB0", "#0E6B6B"),
)

_current = DARK
_scale = 1.0
"""Scale of the whole interface, as set by the user."""

SCALES = (0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
"""Sizes of the interface that the user can choose from."""


def palette() -> Palette:
    """The colours in use."""
    return _current


def rgba(colour: str, alpha: float = 1.0) -> ImVec4:
    """A colour '#RRGGBB' for ImGui's style."""
    r, g, b = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return ImVec4(r, g, b, alpha)


def u32(colour: str, alpha: float = 1.0) -> int:
    """A colour '#RRGGBB' for ImGui's draw lists."""
    return int(imgui.color_convert_float4_to_u32(rgba(colour, alpha)))


def rgb(colour: str) -> tuple[float, float, float]:
    """A colour '#RRGGBB' for the renderers, range [0, 1]."""
    v = rgba(colour)
    return v.x, v.y, v.z


def px(value: float) -> float:
    """A distance in pixels at 96 DPI and the interface's usual size, converted to the window's units."""
    return value * _scale * float(hello_imgui.dpi_window_size_factor())


class Fonts:
    """Fonts besides the default one; `load_fonts` sets them."""

    small: imgui.ImFont | None = None
    bold: imgui.ImFont | None = None


def load_fonts() -> None:
    """Loads Roboto with Font Awesome 6 as the default, and a smaller and a bold Roboto."""
    hello_imgui.get_runner_params().callbacks.default_icon_font = hello_imgui.DefaultIconFont.font_awesome6
    hello_imgui.load_font_ttf_with_font_awesome_icons("fonts/Roboto/Roboto-Regular.ttf", FONT_SIZE)
    Fonts.small = hello_imgui.load_font("fonts/Roboto/Roboto-Regular.ttf", SMALL_SIZE)
    Fonts.bold = hello_imgui.load_font("fonts/Roboto/Roboto-Bold.ttf", FONT_SIZE)


def apply(name: str, size: float = 1.0, scaled_later: bool = False) -> None:
    """Sets all colours, distances and text sizes of the current ImGui context.

    `size`: one of SCALES. `scaled_later`: whether the runner itself scales the distances to the screen's density, as it
    does with the first style.
    """
    global _current, _scale
    _current, _scale = LIGHT if name == "light" else DARK, size
    p, style = _current, imgui.get_style()
    style.font_scale_main = size
    scale = size if scaled_later else px(1.0)
    for field, value in {
        "window_padding": (12, 12),
        "frame_padding": (9, 5),
        "item_spacing": (8, 8),
        "item_inner_spacing": (6, 4),
        "cell_padding": (4, 3),
        "separator_text_padding": (0, 4),
    }.items():
        setattr(style, field, ImVec2(value[0] * scale, value[1] * scale))
    for field, size in {
        "frame_rounding": 5,
        "child_rounding": 5,
        "popup_rounding": 6,
        "window_rounding": 0,
        "selectable_rounding": 5,
        "grab_rounding": 5,
        "tab_rounding": 5,
        "scrollbar_rounding": 5,
        "scrollbar_size": 9,
        "grab_min_size": 10,
        "indent_spacing": 16,
        "docking_separator_size": 2,
    }.items():
        setattr(style, field, size * scale)
    style.window_border_size = style.frame_border_size = style.child_border_size = 0.0
    style.popup_border_size = 1.0
    style.window_menu_button_position = imgui.Dir.none
    style.disabled_alpha = 0.45
    for role, colour in _roles(p).items():
        style.set_color_(getattr(imgui.Col_, role), colour)
    for role, colour in {
        "frame_bg": rgba(p.field, 0),
        "plot_bg": rgba(p.ground, 0.55),
        "plot_border": rgba(p.line, 0),
        "axis_grid": rgba(p.second, 0.18),
        "axis_text": rgba(p.second),
        "axis_bg": rgba(p.panel, 0),
        "legend_bg": rgba(p.panel, 0.0),
        "legend_border": rgba(p.panel, 0.0),
        "legend_text": rgba(p.second),
    }.items():
        implot.get_style().set_color_(getattr(implot.Col_, role), colour)
    implot.get_style().plot_padding = ImVec2(px(6), px(6))


def _roles(p: Palette) -> dict[str, ImVec4]:
    clear = rgba(p.panel, 0)
    return {
        "text": rgba(p.text),
        "text_disabled": rgba(p.second),
        "window_bg": rgba(p.panel),
        "child_bg": clear,
        "popup_bg": rgba(p.panel),
        "border": rgba(p.line),
        "border_shadow": clear,
        "frame_bg": rgba(p.field),
        "frame_bg_hovered": rgba(p.hover),
        "frame_bg_active": rgba(p.pressed),
        "title_bg": rgba(p.ground),
        "title_bg_active": rgba(p.ground),
        "title_bg_collapsed": rgba(p.ground),
        "menu_bar_bg": rgba(p.ground),
        "scrollbar_bg": clear,
        "scrollbar_grab": rgba(p.hover),
        "scrollbar_grab_hovered": rgba(p.pressed),
        "scrollbar_grab_active": rgba(p.second),
        "check_mark": rgba(p.text),
        "slider_grab": rgba(p.second),
        "slider_grab_active": rgba(p.text),
        "button": rgba(p.field),
        "button_hovered": rgba(p.hover),
        "button_active": rgba(p.pressed),
        "header": rgba(p.field),
        "header_hovered": rgba(p.hover),
        "header_active": rgba(p.pressed),
        "separator": rgba(p.line),
        "separator_hovered": rgba(p.second),
        "separator_active": rgba(p.text),
        "resize_grip": clear,
        "tab": rgba(p.panel),
        "tab_hovered": rgba(p.hover),
        "tab_selected": rgba(p.field),
        "tab_dimmed": rgba(p.panel),
        "tab_dimmed_selected": rgba(p.field),
        "docking_preview": rgba(p.accent, 0.4),
        "docking_empty_bg": rgba(p.ground),
        "plot_histogram": rgba(p.accent),
        "text_selected_bg": rgba(p.accent, 0.35),
        "nav_cursor": rgba(p.text),
        "modal_window_dim_bg": rgba("#000000", 0.45),
        "drag_drop_target": rgba(p.accent),
        "tab_selected_overline": clear,
        "tab_dimmed_selected_overline": clear,
    }
