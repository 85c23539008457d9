"""The exemplar prior: invariants of the insides it makes from pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from tests.helpers.exemplar_faces import FLESH, RIND, SEED, UP, ball, disc, quiet, save
from training.families import Family
from training.priors.cubic import read_cubic, spline_coefficients
from training.priors.exemplar import ExemplarPrior, read_picture
from training.priors.exemplar.frames import make_space, rim_of, scale_to_voxels
from training.priors.exemplar.layering.decompose import decompose
from training.priors.exemplar.patches import FIXED, OVER, POLAR
from training.priors.exemplar.rind import rind_depth
from training.priors.prior import Volume


def test_rings_stay_rings_and_rind_stays_out_of_the_core(tmp_path: Path) -> None:
    face, _ = disc()
    family = Family("horizontal", 40, (save(tmp_path / "face.png", face),))
    volume = ExemplarPrior().solve(ball(), UP, [family], 32, 0, quiet)
    depth = volume.body.depth
    core, skin = volume.rgb[depth > 0.3], volume.rgb[(depth > 0.03) & (depth < 0.07)]
    assert np.abs(core - FLESH).max() < 0.1
    assert np.abs(np.median(skin, axis=0) - RIND).max() < 0.05
    # What is the same all around in the picture is the same all around in the volume.
    centres = volume.body.grid.centres()
    level = np.abs(centres[..., 2]) < volume.body.grid.cell
    ring = level & (np.abs(np.hypot(centres[..., 0], centres[..., 1]) - 0.5) < 0.03)
    assert volume.rgb[ring].std(axis=0).max() < 0.02


def test_straight_walls_run_through(tmp_path: Path) -> None:
    """Walls in the picture keep their places at every height."""
    face, mask = disc(200)
    y, x = (np.mgrid[:200, :200] + 0.5) / 100 - 1
    face[mask & (np.minimum(np.abs(x), np.abs(y)) < 0.035) & (np.hypot(x, y) < 0.7)] = 0.95
    family = Family("horizontal", 40, (save(tmp_path / "walls.png", face),))
    volume = ExemplarPrior().solve(ball(32), UP, [family], 48, 0, quiet)
    heights = np.linspace(-0.5, 0.5, 9)
    on = volume.at(np.array([[0.4, 0, h] for h in heights] + [[0, -0.4, h] for h in heights]))
    off = volume.at(np.array([[0.3, 0.3, h] for h in heights]))
    assert on[:, 1].mean() > 0.5
    assert off[:, 1].max() < 0.3


def test_carpels_stay_carpels_and_end(tmp_path: Path) -> None:
    """Radial pictures that all pass through a carpel give its height; they do not make it go all around."""
    flesh, brown = np.array([0.95, 0.92, 0.8]), np.array([0.6, 0.4, 0.2])

    def bend(angle: NDArray[np.floating]) -> NDArray[np.floating]:
        """Angle from the middle of the nearest of five carpels."""
        return (angle + np.pi / 5) % (2 * np.pi / 5) - np.pi / 5

    y, x = (np.mgrid[:240, :240] + 0.5) / 120 - 1
    r, angle = np.hypot(x, y) / 0.8, bend(np.arctan2(y, x))
    out, off = r * np.cos(angle), r * np.sin(angle)
    across = disc(240)[0]
    across[r < 0.88] = flesh
    across[((out - 0.19) / 0.155) ** 2 + (off / 0.085) ** 2 < 1] = brown
    across[((out - 0.22) / 0.05) ** 2 + (off / 0.03) ** 2 < 1] = SEED
    along = disc(240)[0]
    along[r < 0.88] = flesh
    along[((np.abs(x) / 0.8 - 0.18) / 0.15) ** 2 + (y / 0.2) ** 2 < 1] = brown
    along[((np.abs(x) / 0.8 - 0.22) / 0.04) ** 2 + (y / 0.056) ** 2 < 1] = SEED
    families = [
        Family("horizontal", 40, (save(tmp_path / "across.png", across),)),
        Family("radial", 30, (save(tmp_path / "along.png", along),)),
    ]
    volume = ExemplarPrior(same=True).solve(ball(32), UP, families, 64, 0, quiet)
    turns = np.linspace(0, 2 * np.pi, 200)
    for radius in (0.2, 0.28, 0.33):
        out, off = radius * np.cos(bend(turns)), radius * np.sin(bend(turns))
        for height in (-0.4, -0.3, 0.0, 0.1, 0.2, 0.3, 0.4):
            ring = np.stack([radius * np.cos(turns), radius * np.sin(turns), np.full_like(turns, height)], -1)
            dark = (volume.at(ring)[:, 2] < 0.5).mean()
            true = (((out - 0.19) / 0.155) ** 2 + (off / 0.085) ** 2 + (height / 0.25) ** 2 < 1).mean()
            assert abs(dark - true) < 0.2, (radius, height)


def test_a_line_around_a_core_is_one_closed_shell(tmp_path: Path) -> None:
    """An apple's core line: a ring in horizontal pictures, an outline in radial ones, an ellipsoid in the body."""
    wide, tall, flesh, green = 0.45, 0.55, np.array([0.95, 0.92, 0.8]), np.array([0.6, 0.7, 0.35])
    y, x = ((np.mgrid[:320, :320] + 0.5) / 160 - 1) / 0.8
    pictures = []
    for name, high in (("across", wide), ("along", tall)):
        face = disc(320)[0]
        face[np.hypot(x, y) < 0.88] = flesh
        away = np.hypot(x, y) * (1 - 1 / np.hypot(x / wide, y / high))  # distance from the line, along the ray
        face[np.abs(away) < 0.016] = green
        pictures.append(save(tmp_path / f"{name}.png", face))
    families = [Family("horizontal", 40, (pictures[0],)), Family("radial", 30, (pictures[1],))]
    volume = ExemplarPrior().solve(ball(32), UP, families, 112, 0, quiet)
    directions = np.random.default_rng(0).standard_normal((4000, 3))
    shell = directions / np.linalg.norm(directions / [wide, wide, tall], axis=1, keepdims=True)

    def shown(points: NDArray[np.floating]) -> float:
        """Share of points whose colour is closer to green than to flesh."""
        colours = volume.at(points)
        return float((np.linalg.norm(colours - green, axis=1) < np.linalg.norm(colours - flesh, axis=1)).mean())

    assert shown(shell) > 0.9
    for far in (0.4, 0.6, 0.85, 1.15, 1.4):
        assert shown(far * shell) < 0.02, far


def test_seeds_end_and_are_as_many_as_shown(tmp_path: Path) -> None:
    face, _ = disc(seeds=8)
    family = Family("horizontal", 40, (save(tmp_path / "melon.png", face),))
    volume = ExemplarPrior().solve(ball(32), UP, [family], 64, 0, quiet)
    x, y = np.meshgrid(np.linspace(-1, 1, 160), np.linspace(-1, 1, 160))
    counts, dark = [], []
    for h in np.linspace(-0.3, 0.3, 9):
        cut = volume.at(np.stack([x, y, np.full_like(x, h)], -1))
        seeds = (cut[..., 0] < 0.4) & (np.hypot(x, y) < 0.75)
        counts.append(ndimage.label(seeds)[1])
        dark.append(seeds)
    assert 4 <= np.mean(counts) <= 13
    # A seed of one cut is gone half the radius higher; one that ran through would still be there.
    assert (dark[0] & dark[-1]).sum() < 0.3 * dark[0].sum()


def test_colours_by_depth_are_the_pictures(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    face, mask = disc()
    grain = ndimage.gaussian_filter(rng.normal(size=(160, 160)), 1.5)
    face = np.where(mask[..., None], face + 0.06 * (grain / grain.std())[..., None], 1)
    family = Family("horizontal", 40, (save(tmp_path / "grain.png", face),))
    picture = read_picture(family.exemplars[0], "horizontal")
    volume = ExemplarPrior().solve(ball(32), UP, [family], 48, 0, quiet)
    space = make_space(ball(32), UP, 48)
    scaled = scale_to_voxels(picture, space, POLAR, space.widest_slice(space.planar[:, 2]))
    ours = np.sort(volume.rgb[volume.body.depth > 0.25].mean(-1))
    theirs = np.sort(scaled.rgb[scaled.depth > 0.25].mean(-1))
    quantiles = np.linspace(0.02, 0.98, 49)
    assert np.abs(np.quantile(ours, quantiles) - np.quantile(theirs, quantiles)).max() < 0.06


def loaf(n: int = 48) -> Body:
    """A box of half sizes 1, 0.6 and 0.8 whose depth is rounded."""
    cell = 2 / n
    shape = (n + 8, round(0.6 * n) + 8, round(0.8 * n) + 8)
    grid = Grid(-np.array(shape) * cell / 2, cell, shape)
    return Body(grid, (np.array([1, 0.6, 0.8]) - np.abs(grid.centres())).min(-1).astype(np.float32))


def test_a_crust_is_as_thick_in_the_corners_of_a_loaf(tmp_path: Path) -> None:
    y, x = (np.mgrid[:200, :240] + 0.5) / 100 - [[[1.0]], [[1.2]]]
    under = np.minimum(1 - np.abs(x), 0.6 - np.abs(y))
    face = np.where((under < 0.15)[..., None], RIND, FLESH)
    face = np.where((under > 0)[..., None], face, 1.0)
    family = Family("horizontal", 40, (save(tmp_path / "loaf.png", face),))
    volume = ExemplarPrior().solve(loaf(), UP, [family], 80, 0, quiet)
    places = np.stack(np.meshgrid(np.linspace(-1, 1, 101), np.linspace(-0.6, 0.6, 61), [-0.1, 0.2]), -1).reshape(-1, 3)
    under = np.minimum(1 - np.abs(places[:, 0]), 0.6 - np.abs(places[:, 1]))
    rgb = volume.at(places)
    green = rgb[:, 1] > rgb[:, 0]
    assert green[(under > 0.02) & (under < 0.12)].mean() > 0.97
    assert green[(under > 0.18) & (under < 0.3)].mean() < 0.03


def test_the_rim_of_an_ellipse_runs_smoothly() -> None:
    """Its error changes little from voxel to voxel; a step would be a tooth in every thin layer under the skin."""
    x, y, z = np.meshgrid(np.arange(-64, 65), np.arange(-34, 35), np.arange(4), indexing="ij")
    a, b = 60.3, 30.1
    inside = (x / a) ** 2 + (y / b) ** 2 <= 1
    planar = np.stack([x[inside], y[inside], z[inside]], -1).astype(np.float32)
    radius = np.hypot(planar[:, 0], planar[:, 1])
    angle = np.arctan2(planar[:, 1], planar[:, 0])
    true = a * b / np.hypot(b * np.cos(angle), a * np.sin(angle))
    error = np.full(x.shape, np.nan)
    error[inside] = np.where(radius > 0.5 * true, rim_of(planar, radius) - true, np.nan)
    assert np.nanmax(np.abs(error)) < 1
    for axis in (0, 1):
        assert np.nanquantile(np.abs(np.diff(error, axis=axis)), 0.99) < 0.3


def test_splines_are_scipys_also_beyond_the_border() -> None:
    rng = np.random.default_rng(6)
    rgb, at = rng.random((9, 8, 7, 3), np.float32), rng.uniform(-3, 11, (500, 3))
    ours = read_cubic(spline_coefficients(rgb), at)
    for c in range(3):
        spline = ndimage.spline_filter(rgb[..., c], order=3, mode="nearest", output=np.float32)
        theirs = ndimage.map_coordinates(spline, at.T, order=3, mode="nearest", prefilter=False, output=np.float64)
        np.testing.assert_allclose(ours[:, c], theirs, atol=3e-7)


def test_a_spline_is_crisper_and_goes_through_the_cells() -> None:
    rng = np.random.default_rng(5)
    body = ball(16)
    values = (0.5 + 0.1 * ndimage.gaussian_filter(rng.normal(size=(*body.depth.shape, 3)), (1, 1, 1, 0))).astype(
        np.float32
    )
    volume = Volume(body, values)
    np.testing.assert_allclose(volume.at_cubic(body.grid.centres()), values, atol=1e-5)
    between = body.grid.centres()[4:-4, 4:-4, 4:-4] + body.grid.cell / 2
    assert 1.1 < volume.at_cubic(between).std() / volume.at(between).std() < 2


@pytest.mark.parametrize(
    ("plane", "like"),
    [
        (Plane.of((0.1, 0, 1), -0.2), Family("horizontal", 1)),
        (Plane.of((1, 1, 0.1), 0.02), Family("radial", 1)),
        (Plane.of((1, 0, 0), -0.4), Family("parallel", 1, axis=(1.0, 0.0, 0.0))),
        (Plane.of((1, 0, 1), 0.0), Family("parallel", 1, axis=(0.5**0.5, 0.0, 0.5**0.5))),
    ],
)
def test_pictures_of_a_chosen_plane_are_read_by_how_it_lies(tmp_path: Path, plane: Plane, like: Family) -> None:
    pictures = (save(tmp_path / "face.png", disc(seeds=6)[0]),)
    chosen = Family("custom", 1, pictures, custom=(plane,))
    volumes = [
        ExemplarPrior().solve(ball(), UP, [family], 24, 3, quiet)
        for family in (chosen, replace(like, exemplars=pictures))
    ]
    assert np.array_equal(volumes[0].rgb, volumes[1].rgb)


def test_same_seed_same_bits(tmp_path: Path) -> None:
    face, _ = disc(seeds=5)
    path = save(tmp_path / "face.png", face)
    families = [Family("horizontal", 40, (path,)), Family("radial", 30, (path,))]
    seen: list[float] = []
    first = ExemplarPrior().solve(ball(), UP, families, 32, 7, seen.append)
    again = ExemplarPrior().solve(ball(), UP, families, 32, 7, quiet)
    other = ExemplarPrior().solve(ball(), UP, families, 32, 8, quiet)
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert (first.rgb != other.rgb).any()
    assert seen == sorted(seen) and seen[0] == 0 and seen[-1] == 1

    def stop(_: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ExemplarPrior().solve(ball(), UP, families, 16, 0, stop)


@pytest.mark.parametrize("alone", [False, True])
def test_layers_come_from_the_radial_pictures(tmp_path: Path, alone: bool) -> None:
    face, mask = disc(200)
    layered = face.copy()
    layered[94:108][mask[94:108] & (np.abs(np.mgrid[94:108, :200][1] - 100) < 62)] = 0.95
    radial = save(tmp_path / "layered.png", layered)
    # Two radial pictures look alike, but that does not make them a stack.
    families = [Family("radial", 30, (radial, radial))]
    if not alone:
        families.insert(0, Family("horizontal", 40, (save(tmp_path / "flat.png", face),)))
    volume = ExemplarPrior().solve(ball(32), UP, families, 48, 0, quiet)
    turns = np.linspace(0, 2 * np.pi, 12)
    ring = np.stack([0.4 * np.cos(turns), 0.4 * np.sin(turns), 0 * turns], -1)
    assert volume.at(ring)[:, 1].min() > 0.6
    assert volume.at(ring + np.array([0, 0, 0.4]))[:, 1].max() < 0.3


def test_layers_stay_level_up_to_the_skin_of_a_cake_with_crumbs(tmp_path: Path) -> None:
    grid = Grid(-np.array([54, 54, 36]) / 40, 1 / 20, (54, 54, 36))
    p = grid.centres()
    cake = np.minimum(1 - np.hypot(p[..., 0], p[..., 1]), 0.6 - np.abs(p[..., 2]))
    crumbs = [0.15 - np.linalg.norm(p - at, axis=-1) for at in ([1.05, 0, -0.5], [0.3, 0.4, 0.65])]
    body = Body(grid, np.maximum.reduce([cake, *crumbs]).astype(np.float32))
    y, x = (np.mgrid[:150, :240] + 0.5) / 100 - [[[0.75]], [[1.2]]]
    frosted = (np.abs(np.abs(y) - 0.25) < 0.05) | (np.minimum(1 - np.abs(x), 0.6 - np.abs(y)) < 0.07)
    face = np.where(frosted[..., None], [0.95, 0.9, 0.6], FLESH)
    face = np.where(((np.abs(x) < 1) & (np.abs(y) < 0.6))[..., None], face, 1.0)
    family = Family("radial", 30, (save(tmp_path / "cake.png", face),))
    volume = ExemplarPrior().solve(body, UP, [family], 96, 0, quiet)
    for angle in np.linspace(0.5, 6, 8):
        for radius in (0.4, 0.8, 0.88):
            heights = np.linspace(-0.5, 0.5, 101)
            place = [np.full(101, radius * np.cos(angle)), np.full(101, radius * np.sin(angle)), heights]
            white = volume.at(np.stack(place, -1))[:, 1] > 0.5
            assert ndimage.label(white)[1] == 2
            assert np.abs(np.abs(heights[white]).mean() - 0.25) < 0.025


def test_crumbs_are_cut_off_at_the_cream(tmp_path: Path) -> None:
    y, x = ((np.mgrid[:240, :240] + 0.5) / 120 - 1) / 0.8
    face = disc(240)[0]
    face[(np.abs(y) < 0.1) & (np.hypot(x, y) < 0.85)] = [0.95, 0.9, 0.6]
    for across in np.linspace(-0.6, 0.6, 9):
        for up in (-0.19, 0.19, 0.4, -0.4):
            face[np.hypot(x - across, y - up) < 0.07] = SEED
    family = Family("radial", 30, (save(tmp_path / "cake.png", face),))
    volume = ExemplarPrior().solve(ball(32), UP, [family], 80, 0, quiet)
    places = np.random.default_rng(0).uniform(-0.7, 0.7, (40_000, 3))
    places = places[np.hypot(places[:, 0], places[:, 1]) < 0.7]
    dark = volume.at(places)[:, 0] < 0.3
    height = np.abs(places[:, 2])
    assert dark[(height > 0.12) & (height < 0.5)].mean() > 0.02
    assert dark[height < 0.07].mean() < 0.001


def test_slices_of_one_thing_are_turned_into_one_another(tmp_path: Path) -> None:
    """A bone that wanders from slice to slice is half way between two slices, and appears once."""
    y, x = (np.mgrid[:160, :160] + 0.5) / 80 - 1
    paths = []
    for n, at in enumerate((-0.16, 0.0, 0.16)):
        face, _ = disc(160)
        face[np.hypot(x - at, y + 0.2) < 0.14] = 0.95
        face[np.hypot(x, y - 0.35) < 0.2] = [0.3, 0.1, 0.1]
        paths.append(save(tmp_path / f"slice_{n}.png", face))
    cell = 2 / 24
    grid = Grid(np.array([-1.25, -1.25, -1.75]), cell, (30, 30, 42))
    p = grid.centres()
    limb = np.minimum(1 - np.hypot(p[..., 0], p[..., 1]), 1.5 - np.abs(p[..., 2]))
    # Crumbs on the flat ends do not make them natural ends, with skin.
    crumbs = np.stack([p[..., 0] - 0.5, p[..., 1] - 0.2, np.abs(p[..., 2]) - 1.55], -1)
    limb = np.maximum(limb, 0.12 - np.linalg.norm(crumbs, axis=-1))
    body = Body(grid, limb.astype(np.float32))
    volume = ExemplarPrior().solve(body, UP, [Family("horizontal", 40, tuple(paths))], 60, 0, quiet)
    across = np.linspace(-0.7, 0.7, 57)
    row = volume.at(np.stack([across, np.full(57, 0.25), np.full(57, -0.5)], -1))[:, 1]
    bright = row > 0.55
    assert ndimage.label(bright)[1] == 1
    assert abs(across[bright].mean() + 0.08) < 0.05
    assert abs(np.ptp(across[bright]) - 0.34) < 0.12
    ends = volume.at(np.array([[0.5, -0.4, 1.42], [-0.5, -0.4, -1.42]]))
    assert (ends[:, 0] > 2 * ends[:, 1]).all()


def test_decompose_tells_seeds_from_walls(tmp_path: Path) -> None:
    face, mask = disc(240, seeds=7)
    y, x = (np.mgrid[:240, :240] + 0.5) / 120 - 1
    face[mask & (np.abs(y - 0.15 * x) < 0.02) & (np.abs(x) < 0.66)] = 0.95
    space = make_space(ball(), UP, 64)
    picture = read_picture(save(tmp_path / "both.png", face), "horizontal")
    layers = decompose(scale_to_voxels(picture, space, POLAR, space.widest_slice(space.planar[:, 2])), POLAR)
    assert 5 <= len(layers.details) <= 7  # one or two touch the wall
    column, row = round(2 * (layers.source.middle[0] - 8)), round(2 * (layers.source.middle[1] - 1.2))
    assert layers.structure[row - 2 : row + 3, column].max() > 0.7


def test_a_rind_goes_around(tmp_path: Path) -> None:
    """Layers that end at the skin vary in colour along it, and are not a rind."""
    space = make_space(ball(), UP, 64)
    area = space.widest_slice(space.planar[:, 2])
    sandwich = np.ones((160, 240, 3))
    for n, colour in enumerate([(0.8, 0.7, 0.4), (0.8, 0.2, 0.2), (0.9, 0.8, 0.2), (0.3, 0.6, 0.2), (0.8, 0.7, 0.4)]):
        sandwich[20 + 24 * n : 44 + 24 * n, 20:220] = colour
    layered = read_picture(save(tmp_path / "sandwich.png", sandwich), "parallel")
    scaled = scale_to_voxels(layered, space, FIXED, area)
    assert rind_depth(scaled.rgb, scaled.depth, OVER, goes_around=True) < 0.04
    melon = read_picture(save(tmp_path / "melon.png", disc()[0]), "horizontal")
    scaled = scale_to_voxels(melon, space, POLAR, area)
    assert abs(rind_depth(scaled.rgb, scaled.depth, OVER, goes_around=True) - 0.12) < 0.04


def test_rings_are_shells_that_run_along_the_axis(tmp_path: Path) -> None:
    face, mask = disc(400)
    y, x = (np.mgrid[:400, :400] + 0.5) / 200 - 1
    rings = FLESH + 0.02 * np.sin(60 * np.hypot(x, y))[..., None]
    face = np.where(mask[..., None], np.clip(rings, 0, 1), face)
    wood = save(tmp_path / "wood.png", face)
    volume = ExemplarPrior().solve(ball(32), UP, [Family("horizontal", 40, (wood,))], 128, 0, quiet)
    share = np.linspace(0.15, 0.5, 120)
    lines = []
    for height in (-0.35, 0.0, 0.35):
        radius = share * np.sqrt(1 - height**2)
        lines.append(volume.at(np.stack([0.6 * radius, 0.8 * radius, np.full(120, height)], -1))[:, 0])
    for line in (lines[0], lines[2]):
        assert np.corrcoef(line, lines[1])[0, 1] > 0.8
