"""Cuts, pieces and undo, without a window: laws rather than examples."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.model.camera_control import OrbitCamera, project_points
from app.model.document import WHOLE, Document, Key, Part, Placement
from app.model.history import History
from app.model.knife import PlaneAngles, Stroke, blade_of, plane_of, plane_through, slice_evenly, slice_object
from app.model.pieces import PointSample, pieces, sections, shown_points, visible_pieces
from app.model.project import Project, Viewing, load_project, save_project
from app.model.rigid_transform import STILL, Motion
from engine.errors import InputError
from engine.scene.plane import Plane

UP = (0.0, 0.0, 1.0)


def ball(count: int = 3000) -> PointSample:
    points = np.random.default_rng(1).uniform(-1, 1, (2 * count, 3))
    return PointSample.of(points[np.linalg.norm(points, axis=1) < 1])


BALL = ball()
EYE = OrbitCamera(distance=5.0, azimuth=-90.0, elevation=0.0)


def drawn(path: np.ndarray) -> Stroke:
    """A stroke along a line (N, 2)."""
    corners = tuple((float(x), float(y)) for x, y in path)
    return Stroke(corners[0], corners[-1], path=corners)


def arc(middle: tuple[float, float], radius: float, first: float, last: float) -> np.ndarray:
    """Part of a circle between two angles, degrees."""
    turn = np.radians(np.linspace(first, last, 60))
    return np.stack([middle[0] + radius * np.cos(turn), middle[1] + radius * np.sin(turn)], 1)


def blade(path: np.ndarray, scope: Key = WHOLE) -> tuple[Part, ...]:
    facets = blade_of(EYE.camera(400, 300, UP), drawn(path), UP, BALL.centre)
    assert not isinstance(facets, str)
    return tuple(Part(facet.plane, scope, facet.walls) for facet in facets)


blades = st.builds(
    lambda x, y, radius, first, sweep: arc((x, y), radius, first, first + sweep),
    *(st.floats(150, 250), st.floats(100, 200), st.floats(40, 120), st.floats(0, 360)),
    st.sampled_from([-358, -90, 45, 150, 358]),
)
directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)
planes = st.builds(Plane.of, directions, st.floats(-1.3, 1.3))
motions = st.builds(
    lambda axis, angle, shift: Motion.by(shift).after(Motion.about((0, 0, 0), axis, angle)),
    directions,
    st.floats(-180, 180),
    directions,
)


@st.composite
def changes(draw: st.DrawFn, document: Document) -> Document:
    """Any single edit that a user can make."""
    ids = [cut.id for cut in document.cuts]
    keys = [piece.key for piece in pieces(document, BALL)]
    what = draw(
        st.sampled_from(
            ["cut", "blade", "section", *(["move", "toggle", "drop"] if ids else []), *(["lay"] * bool(keys))]
        )
    )
    if what == "blade":
        return document.with_cut(blade(draw(blades), draw(st.sampled_from([WHOLE, *keys]))))
    if what in ("cut", "section"):
        scope = draw(st.sampled_from([WHOLE, *keys]))
        kind: Literal["slice", "section"] = "slice" if what == "cut" else "section"
        return document.with_cut((Part(draw(planes), scope if what == "cut" else WHOLE),), kind=kind)
    if what == "move":
        shift = draw(st.floats(-1, 1))
        return document.changed_cut(draw(st.sampled_from(ids)), lambda cut: replace(cut, shift=shift))
    if what == "toggle":
        return document.changed_cut(draw(st.sampled_from(ids)), lambda cut: replace(cut, on=not cut.on))
    if what == "drop":
        return document.without_cut(draw(st.sampled_from(ids)))
    motion, visible = draw(motions), draw(st.booleans())
    return document.placed(draw(st.sampled_from(keys)), lambda p: replace(p, motion=motion, visible=visible))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_pieces_are_a_partition_whatever_is_done(data: st.DataObject) -> None:
    document = Document()
    for _ in range(data.draw(st.integers(1, 8))):
        document = data.draw(changes(document))
        found = pieces(document, BALL)
        rows = np.sort(np.concatenate([piece.rows for piece in found]))
        assert np.array_equal(rows, np.arange(len(BALL.points)))
        assert len({piece.key for piece in found}) == len(found)
        owners = np.zeros(len(BALL.points), int)
        for piece in found:
            assert len(piece.rows)
            held = np.logical_or.reduce([cell.contains(BALL.points) for cell in piece.cells])
            assert held[piece.rows].all()  # the half-spaces and the points agree
            owners += held
        assert (owners == 1).all()


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_undo_and_redo_are_exact(data: st.DataObject) -> None:
    history = History(Document())
    states = [history.state]
    for step in range(data.draw(st.integers(1, 12))):
        state = data.draw(changes(history.state))
        if history.do(f"step {step}", state):
            states.append(state)
    for state in reversed(states[:-1]):
        assert history.undo() and history.state == state
    assert not history.undo()
    for state in states[1:]:
        assert history.redo() and history.state == state
    assert not history.redo()
    target = data.draw(st.integers(0, len(states) - 1))
    history.jump(target)
    assert history.state == states[target]


def test_a_dragged_slider_is_one_step() -> None:
    history = History(0)
    for value in range(1, 9):
        history.do("Move", value, merge="slider")
    assert [entry.state for entry in history.entries] == [0, 8]
    history.settle()
    history.do("Move", 9, merge="slider")
    assert [entry.state for entry in history.entries] == [0, 8, 9]
    history.do("Move", 8, merge="slider")  # back to where the drag began: no step remains
    assert [entry.state for entry in history.entries] == [0, 8] and history.undo() and history.state == 0


def test_new_work_after_undo_forgets_the_redone() -> None:
    history = History("a")
    history.do("b", "b")
    history.undo()
    history.do("c", "c")
    assert not history.redo() and [entry.state for entry in history.entries] == ["a", "c"]


@settings(max_examples=50, deadline=None)
@given(motions, motions, planes)
def test_motions_are_a_group_and_carry_planes(a: Motion, b: Motion, plane: Plane) -> None:
    points = BALL.points[:50]
    assert np.allclose(a.after(b).apply(points), a.apply(b.apply(points)))
    assert np.allclose(a.inverse().apply(a.apply(points)), points)
    assert np.allclose(Motion.of(a.matrix).matrix, a.matrix)
    assert np.allclose(a.carried(plane).distance(a.apply(points)), plane.distance(points))


def test_a_cut_that_is_taken_back_leaves_the_later_one() -> None:
    document = Document().with_cut((Part(Plane((1.0, 0.0, 0.0), 0.0)),))
    left = pieces(document, BALL)[0].key
    document = document.with_cut((Part(Plane((0.0, 1.0, 0.0), 0.0), left),))
    assert len(pieces(document, BALL)) == 3
    assert len(pieces(document.without_cut(1), BALL)) == 2
    off = document.changed_cut(1, lambda cut: replace(cut, on=False))
    assert len(pieces(off, BALL)) == 2
    assert len(pieces(off.changed_cut(1, lambda cut: replace(cut, on=True)), BALL)) == 3


def test_halves_part_by_the_gap_and_keep_how_they_were_laid() -> None:
    document = replace(Document().with_cut((Part(Plane((1.0, 0.0, 0.0), 0.0)),)), gap=0.5)
    low, high = pieces(document, BALL)
    assert np.allclose(np.subtract(high.motion.shift, low.motion.shift), (0.5 * BALL.radius, 0, 0))
    turned = Motion.about((0, 0, 0), UP, 90)
    document = document.placed(high.key, lambda p: replace(p, motion=turned))
    document = document.with_cut((Part(Plane((0.0, 1.0, 0.0), 0.0), high.key),))
    children = [piece for piece in pieces(document, BALL) if piece.key[:1] == high.key]
    assert len(children) == 2 and all(child.motion.turn == turned.turn for child in children)
    together = document.reassembled()
    assert all(piece.motion == STILL for piece in pieces(together, BALL)) and len(pieces(together, BALL)) == 3
    gone = document.placed(low.key, lambda p: replace(p, removed=True))
    assert len(pieces(gone, BALL)) == 2 and len(pieces(gone.reassembled(), BALL)) == 3


def test_sections_hide_but_do_not_divide() -> None:
    document = Document().with_cut((Part(Plane((0.0, 0.0, 1.0), 0.0)),), "Plane", "section")
    assert len(pieces(document, BALL)) == 1
    moved = document.changed_cut(1, lambda cut: replace(cut, shift=0.25))
    assert sections(moved) == (Plane((0.0, 0.0, 1.0), -0.25),)
    assert sections(document.changed_cut(1, lambda cut: replace(cut, on=False))) == ()
    (whole,) = pieces(moved, BALL)
    seen = shown_points(whole, BALL, sections(moved))  # the points that a selection frame goes around
    assert seen[:, 2].max() <= 0.25 < BALL.points[:, 2].max() and len(seen) > 0.5 * len(BALL.points)


# The knife.


@pytest.mark.parametrize("orthographic", [False, True])
def test_the_plane_of_a_stroke_is_seen_as_the_stroke(orthographic: bool) -> None:
    camera = replace(EYE, elevation=33.0, orthographic=orthographic).camera(400, 300, UP)
    plane = plane_of(camera, Stroke((100, 50), (320, 260)), UP, BALL.centre)
    assert plane is not None
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 3))
    points -= plane.distance(points)[:, None] * np.asarray(plane.normal)
    pixels, _ = project_points(camera, points)
    across = np.array([-(260 - 50), 320 - 100]) / np.hypot(220, 210)
    assert np.abs((pixels - (100, 50)) @ across).max() < 1e-6


def test_the_knife_cuts_what_it_crosses_and_says_when_it_missed() -> None:
    camera = EYE.camera(400, 300, UP)
    through = Stroke((200, 20), (203, 280))
    cut = slice_object(Document(), BALL, camera, through, UP)
    assert cut.document is not None and len(visible_pieces(cut.document, BALL)) == 2 and "two" in cut.message
    for stroke, word in ((Stroke((5, 20), (6, 280)), "missed"), (Stroke((200, 20), (201, 22)), "short")):
        miss = slice_object(Document(), BALL, camera, stroke, UP)
        assert miss.document is None and word in miss.message
    beside = slice_object(
        Document(), BALL, camera, Stroke((5, 150), (20, 150)), UP
    )  # the extended line would cross, the stroke does not
    assert beside.document is None


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_blade_cuts_along_its_line_and_a_closed_one_punches(orthographic: bool) -> None:
    """Each point is on the side of the line on which it is seen, whichever way the line was drawn."""
    camera = replace(EYE, elevation=20.0, orthographic=orthographic).camera(400, 300, UP)
    pixels, _ = project_points(camera, BALL.points)
    bow, ring = arc((200, 450), 320, 240, 300), arc((215, 140), 50, 20, 375)
    from_bow = np.linalg.norm(pixels - (200, 450), axis=1) - 320
    from_ring = np.linalg.norm(pixels - (215, 140), axis=1) - 50
    towards = camera.position / np.linalg.norm(camera.position)
    for line, apart in ((bow, from_bow), (bow[::-1], -from_bow), (ring, from_ring), (ring[::-1], from_ring)):
        cut = slice_object(Document(gap=0.1), BALL, camera, drawn(line), UP).document
        assert cut is not None
        kept, removed = pieces(cut, BALL)
        for piece, sign in ((kept, -1), (removed, 1)):
            assert (sign * apart[piece.rows] > -2).all()  # pixels: the line is made of chords
        gap = kept.motion.shift - np.asarray(removed.motion.shift)
        assert np.linalg.norm(gap) == pytest.approx(0.1 * BALL.radius)
        if apart is from_ring:
            assert gap @ towards == pytest.approx(0.1 * BALL.radius, rel=1e-3)  # towards the user


def test_a_line_that_is_no_blade_is_told() -> None:
    camera = EYE.camera(400, 300, UP)
    back, hidden = (
        [[60, 150], [300, 160], [150, 170]],
        [[60, 60], [340, 60], [340, 80], [80, 80], [80, 240], [60, 240], [60, 62]],
    )
    bow_tie = [[100, 100], [300, 200], [300, 100], [100, 200], [100, 101]]
    shapes = ((back, "turned back"), (hidden, "hides"), (bow_tie, "hides"))
    for line, word in (*shapes, ([[200, 150], [201, 151], [200, 151]], "short")):
        told = slice_object(Document(), BALL, camera, drawn(np.array(line, float)), UP)
        assert told.document is None and word in told.message


def test_a_curved_cut_is_cut_again_taken_back_and_kept_in_a_project(tmp_path: Path) -> None:
    bow = Document(gap=0.0).with_cut(blade(arc((200, 450), 320, 240, 300)))
    stroke = Stroke((200, 20), (203, 280))
    again = slice_object(bow, BALL, EYE.camera(400, 300, UP), stroke, UP).document
    assert again is not None and len(pieces(again, BALL)) == 4
    straight = slice_object(Document(gap=0.0), BALL, EYE.camera(400, 300, UP), stroke, UP).document
    assert straight is not None
    back = again.without_cut(bow.cuts[0].id)
    assert [len(p.rows) for p in pieces(back, BALL)] == [len(p.rows) for p in pieces(straight, BALL)]
    path = tmp_path / "curved.fruitninja"
    save_project(path, Project((again,), Viewing()))
    assert load_project(path).documents == (again,)


def test_one_stroke_cuts_moved_pieces_where_they_lie() -> None:
    camera = EYE.camera(400, 300, UP)
    halves = slice_object(Document(), BALL, camera, Stroke((200, 20), (200, 280)), UP).document
    assert halves is not None
    first = pieces(halves, BALL)[0].key
    lifted = halves.placed(first, lambda p: replace(p, motion=Motion.by((0, 0, 0.3))))
    stroke = Stroke((40, 150), (360, 150))
    quarters = slice_object(lifted, BALL, camera, stroke, UP).document
    assert quarters is not None and len(quarters.cuts) == 2 and len(visible_pieces(quarters, BALL)) == 4
    heights = sorted(abs(part.plane.offset) for part in quarters.cuts[1].parts)
    assert np.allclose(heights, [0.0, 0.3], atol=1e-9)
    only = slice_object(lifted, BALL, camera, stroke, UP, [first]).document
    assert only is not None and len(visible_pieces(only, BALL)) == 3


def test_slices_are_equally_thick_wherever_pieces_lie() -> None:
    normal = np.array([0.6, 0.0, 0.8])
    whole = slice_evenly(Document(), BALL, normal, 7)
    assert whole is not None and len(whole.cuts) == 6
    slices = pieces(whole, BALL)
    assert sorted(np.concatenate([piece.rows for piece in slices])) == list(range(len(BALL.points)))
    thickness = 2 * BALL.radius / 7
    assert len(slices) == 7
    assert all(np.ptp(BALL.points[piece.rows] @ normal) <= thickness * 1.001 for piece in slices)
    # Two halves, one above the other by a gap: slices continue from one into the other as they lie.
    halves = slice_object(Document(), BALL, EYE.camera(400, 300, UP), Stroke((40, 150), (360, 150)), UP).document
    assert halves is not None
    first = pieces(halves, BALL)[0].key
    across = slice_evenly(halves, BALL, np.array(UP), 4)
    assert across is not None and len(visible_pieces(across, BALL)) in (4, 5)
    only = slice_evenly(halves, BALL, np.array([1.0, 0, 0]), 3, [first])
    assert only is not None and len(visible_pieces(only, BALL)) == 4
    hidden = halves
    for piece in pieces(halves, BALL):
        hidden = hidden.placed(piece.key, lambda p: replace(p, visible=False))
    assert slice_evenly(hidden, BALL, normal, 3) is None


@settings(max_examples=40, deadline=None)
@given(planes, directions, directions)
def test_a_plane_is_a_distance_and_two_angles_or_three_points(
    plane: Plane, axis: tuple[float, float, float], centre: tuple[float, float, float]
) -> None:
    up, middle, normal = np.array(axis) / np.linalg.norm(axis), np.array(centre), np.array(plane.normal)
    angles = PlaneAngles.of(plane, up, middle)
    assert np.allclose(plane.distance(middle + angles.distance * normal), 0, atol=1e-9)
    assert np.isclose(np.cos(np.radians(angles.tilt)), normal @ up, atol=1e-9)
    again = angles.plane(up, middle)
    assert np.allclose((*again.normal, again.offset), (*plane.normal, plane.offset), atol=1e-7)
    points = BALL.points[:3] - plane.distance(BALL.points[:3])[:, None] * normal
    through = plane_through(*points)
    if through is not None:
        assert np.allclose(through.distance(points), 0, atol=1e-9)
    assert plane_through(points[0], points[1], 2 * points[1] - points[0]) is None


def test_snapping_gives_the_objects_own_planes() -> None:
    camera = replace(EYE, elevation=20.0).camera(400, 300, UP)
    down = plane_of(camera, Stroke((190, 20), (215, 280), snap=True), UP, BALL.centre)
    across = plane_of(camera, Stroke((20, 160), (380, 140), snap=True), UP, BALL.centre)
    assert down is not None and abs(down.normal[2]) < 1e-12
    assert across is not None and np.allclose(np.abs(across.normal), (0, 0, 1))
    above = replace(EYE, elevation=90.0).camera(400, 300, UP)
    top = plane_of(above, Stroke((20, 160), (380, 140), snap=True), UP, BALL.centre)
    assert top is not None and abs(top.normal[2]) < 1e-9


# The eye.


def test_zooming_keeps_what_lies_under_the_cursor() -> None:
    at = (310.0, 80.0)
    for orthographic in (False, True):
        eye = replace(EYE, elevation=25.0, orthographic=orthographic)
        nearer = eye.zoomed(3, at, (400, 300), UP, 1.0)
        points = np.random.default_rng(3).normal(size=(4000, 3)) * 0.8
        camera = eye.camera(400, 300, UP)
        depth = points @ camera.forward
        flat = points - np.outer(depth, camera.forward)  # on the target's plane
        pixels, _ = project_points(camera, flat)
        nearest = flat[np.argmin(np.linalg.norm(pixels - at, axis=1))][None]
        before, _ = project_points(camera, nearest)
        after, _ = project_points(nearer.camera(400, 300, UP), nearest)
        scale = eye.distance / nearer.distance
        assert np.allclose(after - at, (before - at) * scale, atol=1e-6)


def test_the_wheel_never_jumps_when_a_small_object_is_active() -> None:
    eye = OrbitCamera(distance=15.0)
    farther, nearer = (eye.zoomed(steps, (200.0, 150.0), (400, 300), UP, 0.02).distance for steps in (-1, 1))
    assert farther == 15.0 and nearer == pytest.approx(0.88 * 15.0)


def test_pan_follows_the_hand_and_fit_fits() -> None:
    eye = replace(EYE, elevation=25.0)
    moved = eye.panned(30, -20, 300, UP)
    pixels, _ = project_points(moved.camera(400, 300, UP), np.zeros((1, 3)))
    assert np.allclose(pixels, (200 + 30, 150 - 20))
    fitted = eye.fitted((1, 2, 3), 1.0, 400 / 300)
    pixels, _ = project_points(fitted.camera(400, 300, UP), np.add(BALL.points, (1, 2, 3)))
    assert pixels.min() > 0 and (pixels < (400, 300)).all() and np.ptp(pixels[:, 1]) > 230
    assert fitted.along((0, 0, 1), UP).elevation == 90
    assert eye.toward(fitted, 1.0) == fitted


def test_a_piece_whose_cut_is_undone_is_placed_no_more() -> None:
    whole = Document()
    assert whole.placed(((1, 1),), lambda p: Placement(visible=False)) is whole  # as by a drag that goes on


def test_a_hidden_placement_is_the_childs_too() -> None:
    document = Document().placed(WHOLE, lambda p: Placement(visible=False))
    assert not visible_pieces(document.with_cut((Part(Plane((1.0, 0.0, 0.0), 0.0)),)), BALL)


@pytest.mark.parametrize("name", ["Knife ²", "Knife ٣", "Knife " + "9" * 5000, "Knife "])
def test_a_stranger_s_names_of_cuts_are_counted_on_only_where_they_are_numbers(name: str) -> None:
    document = Document().with_cut((Part(Plane.of((0, 0, 1), 0.0)),))
    document = document.changed_cut(1, lambda cut: replace(cut, name=name))
    assert document.with_cut((Part(Plane.of((0, 0, 1), 0.1)),)).cuts[-1].name == "Knife 1"


def test_a_cut_after_the_largest_id_can_be_saved(tmp_path: Path) -> None:
    document = Document().with_cut((Part(Plane.of((0, 0, 1), 0.0)),))
    document = document.changed_cut(1, lambda cut: replace(cut, id=1 << 53)).with_cut((Part(Plane.of((1, 0, 0), 0.0)),))
    save_project(tmp_path / "a.fruitninja", Project((document,), Viewing()))
    assert load_project(tmp_path / "a.fruitninja").documents[0] == document


def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.fruitninja"
    save_project(path, Project((Document(scene=tmp_path / "melon.ply"),), Viewing()))
    path.write_text(path.read_text(encoding="utf-8").replace("melon", "\\ud800"), encoding="utf-8")
    with pytest.raises(InputError, match="'scene' is no path"):
        load_project(path)


@pytest.mark.parametrize("count", [7, 12])  # oblique cuts: about 40 pieces, and about 170
def test_pieces_of_many_cuts_do_not_overlap(count: int) -> None:
    random, document = np.random.default_rng(count), Document()
    for normal in random.normal(size=(count, 3)):
        document = document.with_cut((Part(Plane.of(normal, random.uniform(-0.5, 0.5))),))
    points = random.uniform(-1, 1, (30_000, 3))  # not the points by which the pieces were divided
    points = points[np.linalg.norm(points, axis=1) < 1]
    beyond = {cut.id: cut.parts[0].plane.distance(points) > 0 for cut in document.cuts}
    forks: dict[tuple[object, ...], dict[int, list[np.ndarray]]] = {}
    for piece in pieces(document, BALL):
        inside = np.all([beyond[cut] == (side > 0) for cut, side in piece.key], axis=0)
        for depth, (cut, side) in enumerate(piece.key):
            fork = forks.setdefault((piece.key[:depth], cut), {-1: [], 1: []})
            fork[side].append(piece.motion.apply(points[inside]) @ document.cut(cut).parts[0].plane.normal)
    assert len(forks) > 5 * count - 10
    for fork in forks.values():  # what a cut has parted stays on its two sides
        kept, removed = (np.concatenate(fork[side]) for side in (-1, 1))
        assert kept.max(initial=-np.inf) < removed.min(initial=np.inf)
