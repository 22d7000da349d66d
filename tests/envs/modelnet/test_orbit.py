"""Moves on the orbit: the table against geometry, names, and a move of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from activelsd import registry
from activelsd.envs.episode import PRESETS
from activelsd.envs.graphenv import ViewGraphEnv, tree_of
from activelsd.envs.modelnet.cameras import VERTICES, Camera, Dodecahedron, Rig, Ring, Rings
from activelsd.envs.modelnet.orbit import OrbitMove, move_tables, with_moves
from activelsd.envs.modelnet.settings import AZIMUTHS
from activelsd.errors import ConfigError, DataError
from tests.graphs import ring_graph

# What the names say, in degrees counter-clockwise and elevations up, written a second time.
MEANT = {
    "orbit_cw": (-30, 0),
    "orbit_ccw": (30, 0),
    "orbit_cw_60": (-60, 0),
    "orbit_ccw_60": (60, 0),
    "orbit_cw_90": (-90, 0),
    "orbit_ccw_90": (90, 0),
    "orbit_opposite": (180, 0),
    "orbit_up": (0, 1),
    "orbit_down": (0, -1),
}

TWELVE = [Rings.even(AZIMUTHS, [30.0])] * 3


def table_of(names: Sequence[str], rig: Rig) -> NDArray[np.int32]:
    return move_tables(names, [rig])[rig]


def ring_table(names: Sequence[str], elevations: int) -> NDArray[np.int32]:
    return table_of(names, Rings.even(AZIMUTHS, range(elevations)))


def camera(azimuth: float, level: int) -> tuple[float, float, int]:
    return (round(np.cos(np.radians(azimuth)), 6), round(np.sin(np.radians(azimuth)), 6), level)


@pytest.mark.parametrize("elevations", [2, 3, 5])
def test_moves_lead_to_the_camera_that_stands_there(elevations: int) -> None:
    assert list(MEANT) == registry.orbit_moves.own()
    cameras = [camera(30 * a, level) for level in range(elevations) for a in range(AZIMUTHS)]
    table = ring_table(list(MEANT), elevations)
    assert (table.shape, table.dtype) == ((len(cameras), len(MEANT)), np.int32)
    for view, (x, y, level) in enumerate(cameras):
        azimuth = np.degrees(np.arctan2(y, x))
        for column, (around, up) in enumerate(MEANT.values()):
            wanted = camera(azimuth + around, level + up)
            near = [i for i, other in enumerate(cameras) if np.allclose(wanted, other, atol=1e-4)]
            assert table[view, column] == (near[0] if near else -1)


def test_one_elevation_has_every_move_around_and_none_is_blocked() -> None:
    names = [name for name, (_, up) in MEANT.items() if not up]
    table = ring_table(names, 1)
    several = ring_table(names, 3)
    assert (table >= 0).all()
    assert np.array_equal(several[:AZIMUTHS], table)
    for column in range(len(names)):
        assert sorted(table[:, column]) == list(range(AZIMUTHS))


def test_the_ends_block_up_and_down_and_nothing_else() -> None:
    up, down = ring_table(["orbit_up", "orbit_down"], 3).T.reshape(2, 3, AZIMUTHS)
    assert (up[2] == -1).all()
    assert (down[0] == -1).all()
    assert (up[:2] >= 0).all()
    assert (down[1:] >= 0).all()


def test_an_environment_is_blocked_at_both_ends() -> None:
    graph = ring_graph(objects=3, classes=1, elevations=2, moves=("orbit_up", "orbit_down"))
    env = ViewGraphEnv(graph, PRESETS["V1"])
    _, info = env.reset(seed=0)
    start = int(graph.start_view[graph.find(info["episode_id"])])
    moved, places = [], []
    for action in (2, 1, 1, 2):  # down, up, up, down: blocked, up, blocked, down
        observation, *_, info = env.step(action)
        moved.append(info["moved"])
        places.append(observation["frames"][-1])
    assert moved == [False, True, False, True]
    expected = [start, start + 12, start + 12, start]
    assert all(np.array_equal(seen, graph.frames[v]) for seen, v in zip(places, expected, strict=True))
    assert info["views"] == 5


def test_every_object_keeps_to_its_own_views() -> None:
    graph = ring_graph(objects=6, classes=2, elevations=2, moves=tuple(MEANT))
    ring = ring_table(list(MEANT), 2)
    for view, row in enumerate(graph.moves):
        first = view // 24 * 24
        assert row.tolist() == [to + first if to >= 0 else -1 for to in ring[view - first]]
        assert {graph.scene_of[to] for to in row if to >= 0} == {graph.scene_of[view]}


def test_other_moves_replace_those_there_were() -> None:
    graph = with_moves(ring_graph(objects=3, classes=1), ["orbit_opposite"], TWELVE)
    assert graph.move_names == ("orbit_opposite",)
    assert graph.moves.shape == (36, 1)
    assert graph.moves[:12, 0].tolist() == [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]


def test_a_move_of_ones_own_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.orbit_moves._added, "climb_right", OrbitMove(around=60, up=1))
    graph = ring_graph(objects=3, classes=1, elevations=2, moves=("orbit_cw", "climb_right"))
    env = ViewGraphEnv(graph, PRESETS["V4"])
    env.reset(options={"episode": "train:object_0:object_0:0_330"})
    observation, *_, info = env.step(env.tree.index("navigate", "climb_right"))
    assert info["moved"]
    assert np.array_equal(observation["frames"][-1], graph.frames[graph.view_names.index("1_030")])


@pytest.mark.parametrize(
    ("names", "elevations", "sentence"),
    [
        (["orbit_cww"], 1, "There is no orbit move 'orbit_cww'; did you mean orbit_cw?"),
        (
            ["orbit_cw", "orbit_up"],
            1,
            "'orbit_up' needs more than one elevation; ask for some, as in env.elevations=[0,30].",
        ),
    ],
)
def test_errors_are_one_sentence(names: list[str], elevations: int, sentence: str) -> None:
    with pytest.raises(ConfigError) as error:
        ring_table(names, elevations)
    assert str(error.value) == sentence


def test_a_name_like_none_gets_the_list() -> None:
    with pytest.raises(ConfigError, match=r"no orbit move 'zzz'; there are orbit_cw, orbit_ccw, "):
        ring_table(["zzz"], 1)


@pytest.mark.parametrize("count", [1, 2, 5, 6, 8, 16, 20, 36, 80])
def test_on_a_ring_of_any_number_an_angle_is_the_nearest_number_of_cameras(count: int) -> None:
    rig = Rings.even(count, [30.0])
    table = table_of([name for name in MEANT if not MEANT[name][1]], rig)
    for column, (name, (degrees, up)) in enumerate(MEANT.items()):
        if up:
            continue
        cameras = [1.0 if abs(degrees) == 30 else abs(degrees) * count / 360]
        steps = max(1, int(cameras[0] + 0.5)) * (1 if degrees > 0 else -1)
        meant = [(view + steps) % count for view in range(count)]
        assert table[:, column].tolist() == (meant if steps % count else [-1] * count), name
    assert len({one.name for one in rig.cameras}) == count


def test_a_move_of_ones_own_keeps_its_angle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.orbit_moves._added, "crooked", OrbitMove(around=45))
    assert table_of(["crooked"], Rings.even(16, [0.0]))[0] == [2]
    assert table_of(["crooked"], Rings.even(8, [0.0]))[0] == [1]
    assert table_of(["crooked"], Rings.even(12, [0.0]))[0] == [2], "half a camera counts as one"


def test_rings_of_different_numbers_are_joined_at_the_nearest_azimuth() -> None:
    eight = Ring(60.0, tuple(10 + 45.0 * i for i in range(8)))
    rig = Rings((*Rings.even(16, [0.0]).rings, eight, Ring(90.0, (0.0,))))
    up, down, cw = table_of(["orbit_up", "orbit_down", "orbit_cw"], rig).T
    assert up[:5].tolist() == [16, 16, 17, 17, 18]  # 22.5 is nearer to 10 than to 55
    assert up[15] == 23, "337.5 is 32.5 from 10, and 12.5 from 325"
    assert set(up[16:24]) == {24}
    assert (down[:16] == -1).all()
    assert down[16:18].tolist() == [0, 2]
    assert cw[[0, 16, 24]].tolist() == [15, 23, -1]
    assert (rig.starts, len(rig.cameras)) == (16, 25)


def test_objects_keep_their_own_rings() -> None:
    rigs = [Rings.even(count, [30.0]) for count in (8, 12, 3)]
    graph = replace(ring_graph(objects=2, classes=1), scenes=("a", "b", "c"))
    short = replace(
        graph, scene_of=np.repeat(np.arange(3, dtype=np.int32), [8, 12, 3]), moves=graph.moves[:23]
    )
    table = with_moves(short, ["orbit_ccw"], rigs).moves[:, 0]
    assert table.tolist() == [*range(1, 8), 0, *range(9, 20), 8, 21, 22, 20]


def test_moves_on_the_dodecahedron_follow_its_edges() -> None:
    rig = Dodecahedron()
    vertices = np.array(VERTICES)
    assert np.allclose(np.square(vertices).sum(1), 3)
    edges = np.isclose(np.linalg.norm(vertices[:, None] - vertices, axis=2), 2 / ((1 + 5**0.5) / 2))
    assert (edges.sum(1) == 3).all()
    for one, (x, y, z) in zip(rig.cameras, vertices, strict=True):
        a, e = np.radians(one.azimuth), np.radians(one.elevation)
        assert np.allclose(
            [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], np.array([x, y, z]) / 3**0.5
        )
    names = ["orbit_cw", "orbit_ccw", "orbit_up", "orbit_down", "orbit_opposite"]
    table = table_of(names, rig)
    for view, row in enumerate(table.tolist()):
        assert all(edges[view, to] for to in row[:4] if to >= 0)
        assert np.allclose(vertices[row[4]], vertices[view] * [-1, -1, 1])
        up, down = row[2:4]
        assert up == -1 or vertices[up, 2] > vertices[view, 2]
        assert down == -1 or vertices[down, 2] < vertices[view, 2]
    assert (table[:, 2] == -1).sum() == (table[:, 3] == -1).sum() == 2
    view, seen = 0, set()
    while view not in seen:
        seen.add(view)
        view = int(table[view, 0])
    assert len(seen) == 10, "clockwise goes all around the object"
    assert Camera(22.5, 30).name == "e30_a022.5"


def test_moves_named_twice_or_not_at_all_are_refused() -> None:
    graph = ring_graph(objects=3, classes=1)
    with pytest.raises(ConfigError, match="'orbit_cw' is named twice"):
        tree_of(with_moves(graph, ["orbit_cw", "orbit_cw"], TWELVE))
    with pytest.raises(DataError, match="no move"):
        tree_of(replace(with_moves(graph, [], TWELVE)))
