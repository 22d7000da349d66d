"""View graphs: what they answer, and files that are whole or refused."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from activelsd.envs import viewgraph
from activelsd.envs.viewgraph import FORMAT, SPLITS, ViewGraph, load_graph, read_key, save_graph
from activelsd.errors import DataError
from tests.graphs import ring_graph, room_graph

GRAPHS = [ring_graph(objects=6, classes=2, elevations=2), room_graph(), room_graph(crops=False)]


def assert_same(one: ViewGraph, other: ViewGraph) -> None:
    for field in fields(ViewGraph):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        if isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, theirs, err_msg=field.name, strict=True)
        else:
            assert mine == theirs, field.name


def test_made_up_worlds_hold_what_the_tests_need() -> None:
    room = GRAPHS[1]
    assert room.pair_of is not None
    assert (room.moves == -1).any()
    back = [set(room.moves[to]) for to in range(len(room.moves))]
    assert any(to >= 0 and view not in back[to] for view, row in enumerate(room.moves) for to in row)
    assert (room.pair_of[room.start_view, room.start_target] == -1).any()
    for graph in GRAPHS:
        assert {SPLITS[i] for i in graph.start_split} == set(SPLITS)
        assert len(np.unique(graph.frames, axis=0)) == len(graph.frames)


@pytest.mark.parametrize("graph", GRAPHS)
def test_episode_ids_name_their_start_and_are_found_again(graph: ViewGraph) -> None:
    ids = set()
    for row, view in enumerate(graph.start_view):
        episode = graph.episode(row)
        assert graph.find(episode.id) == row
        assert episode.scene == graph.scenes[graph.scene_of[view]]
        assert episode.start == graph.view_names[view]
        assert episode.target == graph.targets[graph.start_target[row]]
        assert episode.label == graph.labels[graph.start_target[row]]
        ids.add(episode.id)
    assert len(ids) == len(graph.start_view)


def test_starts_are_the_rows_of_a_split() -> None:
    graph = GRAPHS[1]
    rows = [graph.starts(split) for split in SPLITS]
    assert np.array_equal(np.sort(np.concatenate(rows)), np.arange(len(graph.start_view)))
    for split, own in zip(SPLITS, rows, strict=True):
        assert {graph.episode(int(row)).split for row in own} == {split}


def test_targets_out_of_sight_are_zeros() -> None:
    graph = GRAPHS[1]
    assert graph.pair_of is not None
    assert graph.boxes is not None
    assert graph.crops is not None
    for view, target in np.ndindex(graph.pair_of.shape):
        pair = graph.pair_of[view, target]
        box, crop = graph.target_box(view, target), graph.crop(view, target)
        assert box.dtype == np.float32
        if pair < 0:
            assert not box.any()
            assert not crop.any()
        else:
            assert box.tolist() == [*graph.boxes[pair].tolist(), 1.0]
            assert np.array_equal(crop, graph.crops[pair])


def test_a_target_that_fills_the_frame_needs_no_box() -> None:
    assert GRAPHS[0].target_box(3, 0).tolist() == [0.5, 0.5, 1.0, 1.0, 1.0]


def test_errors_name_the_thing_and_the_way_out() -> None:
    ring = GRAPHS[0]
    with pytest.raises(DataError, match=r"^There is no split 'tset'; choose one of train, val, test\.$"):
        ring.starts("tset")
    alone = replace(ring, start_split=np.zeros_like(ring.start_split))
    with pytest.raises(DataError, match=r"^The 'test' split has no episode; "):
        alone.starts("test")
    with pytest.raises(DataError, match=r"^There is no episode 'here'; ids look like 'train:object_0:"):
        ring.find("here")
    for graph in (ring, GRAPHS[2]):
        with pytest.raises(DataError, match=r"has no crops; turn `crops` off"):
            graph.crop(0, 0)


@pytest.mark.parametrize("graph", GRAPHS)
def test_a_file_gives_back_the_graph_and_its_key(tmp_path: Path, graph: ViewGraph) -> None:
    path = tmp_path / "deep" / "er" / "graph.h5"
    save_graph(graph, path, {"of": "tests", "sizes": [1, 2]})
    assert_same(graph, load_graph(path))
    assert read_key(path) == {"of": "tests", "sizes": [1, 2]}
    assert [file.name for file in path.parent.iterdir()] == ["graph.h5"]


def test_a_graph_without_moves_is_kept_too(tmp_path: Path) -> None:
    graph = ring_graph(objects=6, classes=2, moves=())
    save_graph(graph, tmp_path / "graph.h5", {})
    assert_same(graph, load_graph(tmp_path / "graph.h5"))


def test_pictures_are_mapped_and_writing_to_them_leaves_the_file(tmp_path: Path) -> None:
    path = tmp_path / "graph.h5"
    save_graph(GRAPHS[1], path, {})
    before = path.read_bytes()
    graph = load_graph(path)
    assert isinstance(graph.frames, np.memmap)
    assert isinstance(graph.crops, np.memmap)
    graph.frames[:] = 7
    assert path.read_bytes() == before


def test_chunked_pictures_are_read(tmp_path: Path) -> None:
    path = tmp_path / "graph.h5"
    save_graph(GRAPHS[1], path, {})
    with h5py.File(path, "r+") as file:
        frames = file["frames"][:]
        del file["frames"]
        file.create_dataset("frames", data=frames, chunks=(1, 12, 12), compression="gzip")
    assert_same(GRAPHS[1], load_graph(path))


@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_file_is_one_sentence(tmp_path: Path, kept: float) -> None:
    path = tmp_path / "graph.h5"
    save_graph(GRAPHS[1], path, {"of": "tests"})
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * kept)])
    with pytest.raises(DataError) as error:
        load_graph(path)
    assert str(path) in str(error.value)
    assert str(error.value).endswith("delete it and prepare it again.")
    assert read_key(path) is None


def test_foreign_missing_and_unsealed_files_are_one_sentence(tmp_path: Path) -> None:
    text, other, unsealed = tmp_path / "a.h5", tmp_path / "b.h5", tmp_path / "c.h5"
    text.write_text("No HDF5 at all.")
    with h5py.File(other, "w") as file:
        file["frames"] = np.zeros(3)
        file.attrs["format"] = FORMAT + "0"
    with h5py.File(unsealed, "w") as file:
        viewgraph.write_graph(file, GRAPHS[0])
    for path in (text, other, unsealed, tmp_path / "missing.h5", tmp_path):
        with pytest.raises(DataError, match="delete it and prepare it again"):
            load_graph(path)
        assert read_key(path) is None


def test_a_crash_in_the_middle_leaves_no_file_and_an_old_one_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "graph.h5"

    def crash(*_: object) -> None:
        assert not path.exists() or path.read_bytes() == old
        raise KeyboardInterrupt

    monkeypatch.setattr(viewgraph, "seal", crash)
    with pytest.raises(KeyboardInterrupt):
        save_graph(GRAPHS[0], path, {})
    assert not path.exists()
    monkeypatch.undo()
    save_graph(GRAPHS[0], path, {"age": "old"})
    old = path.read_bytes()
    for step in ("write_graph", "seal", "replace_durably"):
        with monkeypatch.context() as patch:
            patch.setattr(viewgraph, step, crash)
            with pytest.raises(KeyboardInterrupt):
                save_graph(GRAPHS[1], path, {"age": "new"})
        assert path.read_bytes() == old
    save_graph(GRAPHS[1], path, {"age": "new"})
    assert read_key(path) == {"age": "new"}
    assert_same(GRAPHS[1], load_graph(path))
