"""The window's texts: all are in the template from which translations begin, and a catalogue changes them."""

from __future__ import annotations

import ast
import gettext
import io
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from babel.messages.catalog import Catalog
from babel.messages.extract import extract_from_dir, extract_from_file
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po

from tests.paths import ROOT
from training.events import STAGES

TEMPLATE = ROOT / "app" / "locale" / "fruitninja.pot"

WRITE = {
    "text_unformatted": (0,), "text_wrapped": (0,), "text_disabled": (0,), "button": (0,), "checkbox": (0,),
    "selectable": (0,), "menu_item": (0,), "menu_item_simple": (0,), "begin_menu": (0,), "tree_node_ex": (0,),
    "begin_combo": (1,), "input_text_with_hint": (1,), "add_text": (2,), "tooltip": (0,), "secondary": (0,),
    "heading": (0,), "row_label": (0,), "right_text": (0,), "main_button": (0,), "icon_button": (0,), "list_row": (0,),
    "label": (2,), "notify": (0,), "show_error": (0,), "ask": (0, 1), "Choice": (0,), "change": (0,), "Command": (1,),
    "change_object": (0,), "change_all": (0,), "change_film": (0,), "change_cut": (0,), "change_placements": (0,),
}  # fmt: skip
"""Functions that draw text for the user, and the positions of their text arguments."""


def messages(catalog: Catalog) -> set[object]:
    """Texts to translate, plural forms as pairs."""
    return {message.id for message in catalog if message.id}


def test_the_template_has_all_words_of_the_code() -> None:
    found = {message for _, _, message, _, _ in extract_from_dir(str(ROOT / "app"))}
    stages = {message for _, message, _, _ in extract_from_file("python", str(ROOT / "training/events.py"))}
    assert stages == set(STAGES.values())
    found |= stages
    with TEMPLATE.open("rb") as file:
        assert messages(read_po(file)) == found, "make words"
    assert len(found) > 500


def bare(node: ast.expr) -> Iterator[str]:
    """Untranslated texts in an expression: not those in a call, which may be of `_`."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        if re.search(r"[A-Za-z]{2}", node.value.partition("##")[0]):
            yield node.value
    elif isinstance(node, ast.JoinedStr):
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        if re.search(r"[A-Za-z]{2}", text.partition("##")[0]):
            yield text
    elif isinstance(node, (ast.IfExp, ast.BinOp)):
        parts = (node.body, node.orelse) if isinstance(node, ast.IfExp) else (node.left, node.right)
        for part in parts:
            yield from bare(part)


def test_no_word_is_written_untranslated() -> None:
    calls, found = 0, []
    for path in [*(ROOT / "app" / "ui").rglob("*.py"), *(ROOT / "app" / "session").glob("*.py")]:
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call):
                continue
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            for place in WRITE.get(name, ()):
                if place < len(call.args):
                    calls += 1
                    found += [f"{path.name}:{call.lineno}: {text}" for text in bare(call.args[place])]
    assert not found, found
    assert calls > 400


def test_placeholders_can_be_filled_in_by_name() -> None:
    with TEMPLATE.open("rb") as file:
        for message in read_po(file):
            texts = [message.id] if isinstance(message.id, str) else list(message.id)
            fields = [set(re.findall(r"\{(\w*)", text)) for text in texts]
            assert all(fields[0] == other or other < fields[0] for other in fields[1:]) or "count" in fields[-1], texts
            assert sum("" in names for names in fields) == 0 or texts[0].startswith("({:.3g}"), texts


def test_a_catalogue_is_found_by_the_users_language(tmp_path: Path) -> None:
    catalog = Catalog(locale="pl")  # three plural forms: 1, 2 to 4, and 5
    catalog.add("Open...", "Otwórz...")
    catalog.add(("{count} piece", "{count} pieces"), ("{count} kawałek", "{count} kawałki", "{count} kawałków"))
    folder = tmp_path / "pl" / "LC_MESSAGES"
    folder.mkdir(parents=True)
    data = io.BytesIO()
    write_mo(data, catalog)
    (folder / "fruitninja.mo").write_bytes(data.getvalue())
    script = (
        "import sys, pathlib, gettext; find = gettext.translation\n"
        "gettext.translation = lambda name, folder, fallback: find(name, sys.argv[1], fallback=fallback)\n"
        "from app.translation import _, ngettext\n"
        "pieces = [ngettext('{count} piece', '{count} pieces', n).format(count=n) for n in (1, 3, 5)]\n"
        "print(_('Open...'), _('Save'), *pieces)"
    )
    for language, said in (
        ("pl", "Otwórz... Save 1 kawałek 3 kawałki 5 kawałków"),
        ("xx", "Open... Save 1 piece 3 pieces 5 pieces"),
    ):
        environment = os.environ | {"LANGUAGE": language, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}
        command = [sys.executable, "-c", script, str(tmp_path)]
        done = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", timeout=60)
        assert done.stdout.strip() == said, done.stderr
    assert gettext.find("fruitninja", tmp_path, ["pl"])
