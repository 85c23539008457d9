"""Manifests of batches: checked as a whole, and what their keys come to."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from engine.errors import InputError
from engine.isolate.selection import NO_FLOOR, NO_SURROUNDINGS, Box, keep_only
from tests.paths import SAMPLES
from tests.training.test_batch import MANIFEST
from training.batch.manifest import ManifestErrors, read_manifest


def test_a_manifest_is_checked_as_a_whole(tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply"):
        (tmp_path / name).touch()
    (tmp_path / "text.png").write_text("no picture")
    picture = f"{SAMPLES}/orange/horizontal_1.png"
    manifest = tmp_path / "all.toml"
    manifest.write_text(f"""
        colour = "red"
        [defaults]
        exemplar = {{ horizontal = "{picture}" }}
        sede = 1
        [[scene]]
        scene = "a.ply"
        [[scene]]
        scene = "A.ply"
        [[scene]]
        scene = "b.ply"
        name = "A"
        [[scene]]
        scene = "b.ply"
        name = "../b"
        [[scene]]
        scene = "b.ply"
        detail = "extreme"
        [[scene]]
        scene = "b.ply"
        family = ["parallel:3"]
        [[scene]]
        scene = "b.ply"
        exemplar = {{ radial = "text.png" }}
        [[scene]]
        scene = "b.ply"
        seed = -1
        [[scene]]
        scene = "b.ply"
        up = [0, 0, nan]
        [[scene]]
        scene = "b.ply"
        prior = "stable-diffusion"
    """)
    with pytest.raises(ManifestErrors) as caught:
        read_manifest(manifest)
    lines = str(caught.value).splitlines()
    wanted = [
        "the file: unknown key 'colour'",
        "defaults: unknown key 'sede'",
        "scene 2 (A.ply): ",
        "scene 3 (A): its result would be 'A', as that of scene 1 (a.ply); give one of them a name",
        "scene 4 (../b): name '../b': cannot be a folder",
        "scene 5 (b.ply): detail 'extreme': unknown; choose draft, standard, high",
        "scene 6 (b.ply): horizontal: pictures or words but no planes; add family horizontal:40",
        f"scene 7 (b.ply): {tmp_path / 'text.png'}: this is no picture",
        "scene 8 (b.ply): seed: give a whole number",
        "scene 9 (b.ply): up 0,0,nan: give x, y, z",
        "scene 10 (b.ply): model and midas belong to",
    ]
    assert len(lines) == len(wanted)
    for line, start in zip(lines, wanted, strict=True):
        assert line.startswith(f"{manifest}: {start}")

    deep = "a." * 50_000
    refused = {"= 1": "no TOML", "": "no scenes", "scene = 3": "no scenes", "\xff": "not a manifest"}
    refused |= {f"{deep}a = 1": "line 1: over 40 dots", f'x = """\n#"""\n[{deep}': "line 3: over 40 dots"}
    for text, message in refused.items():
        manifest.write_bytes(text.encode("latin-1"))
        with pytest.raises(InputError, match=message):
            read_manifest(manifest)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["batch.json"], "the batch writes a file of this name itself"),
        (["Batch.JSON"], "the batch writes"),
        (["x.lock"], "the batch writes"),
        (["CON"], "a device on Windows"),
        (["lpt1.ply"], "a device on Windows"),
        (["Com¹ .tar.gz"], "a device on Windows"),
        (["melon."], "cannot be a folder"),
        (["melon "], "cannot be a folder"),
        (["\N{CJK UNIFIED IDEOGRAPH-4E00}" * 90], "cannot be a folder"),
        (["Melon", "mELON"], "its result would be 'mELON', as that of scene 1"),
        (["caf\u00e9", "cafe\u0301"], "as that of scene 1"),
        (["Stra\u00dfe", "STRASSE"], "as that of scene 1"),
    ],
)
def test_names_are_folders_everywhere_and_of_one_scene(tmp_path: Path, names: list[str], message: str) -> None:
    (tmp_path / "a.ply").touch()
    manifest = tmp_path / "all.toml"
    picture = f"{SAMPLES}/orange/horizontal_1.png"
    text = "".join(f'[[scene]]\nscene = "a.ply"\nname = "{name}"\n' for name in names)
    manifest.write_text(f'[defaults]\nexemplar = {{ horizontal = "{picture}" }}\n{text}', encoding="utf-8")
    with pytest.raises(ManifestErrors) as caught:
        read_manifest(manifest)
    assert message in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_names_that_only_look_like_devices_are_folders(tmp_path: Path) -> None:
    (tmp_path / "a.ply").touch()
    manifest = tmp_path / "all.toml"
    names = ["console", "com10", "aux_1", "batch.json.old", "a.b.c", "cafe\u0301"]
    text = "".join(f'[[scene]]\nscene = "a.ply"\nname = "{name}"\n' for name in names)
    picture = f"{SAMPLES}/orange/horizontal_1.png"
    manifest.write_text(f'[defaults]\nexemplar = {{ horizontal = "{picture}" }}\n{text}', encoding="utf-8")
    assert [scene.name for scene in read_manifest(manifest)] == [*names[:-1], "caf\u00e9"]


def test_defaults_give_way_to_a_scenes_own(tmp_path: Path) -> None:
    manifest = tmp_path / "all.toml"
    manifest.write_text(MANIFEST)
    (tmp_path / "broken.ply").touch()
    killed, broken, melon = read_manifest(manifest)
    assert (killed.name, broken.name, melon.name) == ("killed", "broken", "bread")
    assert (killed.request.detail, melon.request.detail) == ("standard", "draft")
    assert (killed.request.seed, melon.request.seed) == (0, 3)
    assert [(f.kind, f.count, len(f.exemplars)) for f in melon.request.families] == [("parallel", 4, 1)]
    assert broken.request.scene == tmp_path / "broken.ply"
    assert melon.request.up == (0.0, 0.0, 1.0)


def test_a_scene_says_what_is_the_object_and_how_its_pictures_are_related(tmp_path: Path) -> None:
    (tmp_path / "a.ply").touch()
    (tmp_path / "cuts").mkdir()
    for picture in ("one.png", "two.png", "two.mask.png"):
        shutil.copy(SAMPLES / "orange/horizontal_1.png", tmp_path / "cuts" / picture)
    manifest = tmp_path / "all.toml"
    text = """
        [[scene]]
        scene = "a.ply"
        exemplar = { horizontal = "cuts" }
        keep = ["box:1,0,0,0,1,1"]
        no_floor = true
        no_surroundings = true
        same = true
        compact = true
    """
    manifest.write_text(text)
    (scene,) = read_manifest(manifest)
    assert scene.request.same and scene.request.compact
    assert [path.name for path in scene.request.families[0].exemplars] == ["one.png", "two.png"]  # and no mask
    assert scene.request.isolation == (NO_SURROUNDINGS, keep_only(Box((0.0,) * 3, (1.0,) * 3)), NO_FLOOR)
    manifest.write_text(text.replace("floor = true", 'floor = "yes"').replace("box:1", "cone:1"))
    with pytest.raises(ManifestErrors, match=r"keep cone:1,0,0,0,1,1: give box|no_floor: give true or false"):
        read_manifest(manifest)
