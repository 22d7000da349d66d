"""Furniture and small things: sound models, the same whenever asked for, look-alikes but for a label."""

from __future__ import annotations

import numpy as np
import pytest

from activelsd.errors import DataError
from activelsd.scenery.rooms import household
from activelsd.scenery.rooms.fittings import FITTINGS, Fitted
from activelsd.scenery.rooms.household import household_thing
from activelsd.scenery.rooms.library import SIZES, Embedded
from activelsd.scenery.rooms.smallthings import KINDS, LABELS, small_thing


def check(model):
    vertices, faces = model.mesh
    used = vertices[np.unique(faces)]
    assert np.isfinite(vertices).all()
    assert len(model.paint) == len(faces)
    assert model.paint.min() >= 0
    assert model.paint.max() < len(model.materials)
    np.testing.assert_allclose(used.min(axis=0)[2], 0.0, atol=1e-5)
    np.testing.assert_allclose(used.min(axis=0)[:2], -used.max(axis=0)[:2], atol=1e-4)


def same(a, b):
    return (
        a.mesh.vertices.tobytes() == b.mesh.vertices.tobytes()
        and a.mesh.faces.tobytes() == b.mesh.faces.tobytes()
        and a.paint.tobytes() == b.paint.tobytes()
        and a.materials == b.materials
    )


@pytest.mark.parametrize("kind", KINDS)
def test_small_things_are_sound_and_small(kind):
    for number in range(10):
        model = small_thing(kind, number)
        check(model)
        assert 0.05 < max(model.size) < 0.4
        assert same(model, small_thing(kind, number))


@pytest.mark.parametrize("kind", KINDS)
def test_a_family_shares_all_but_the_label(kind):
    """Same geometry; the paint differs, on the front and on the back, and in nothing but dark and light."""
    family = [small_thing(kind, number) for number in range(len(LABELS))]
    first = family[0]
    colours = [np.array([m.materials[p].colour for p in m.paint]) for m in family]
    middles = first.mesh.vertices[first.mesh.faces].mean(axis=1)
    for other, colour in zip(family[1:], colours[1:], strict=True):
        np.testing.assert_array_equal(other.mesh.vertices, first.mesh.vertices)
        differs = (colour != colours[0]).any(axis=1)
        assert differs.any()
        changed = middles[differs, 1]
        assert changed.min() < changed.max() - 0.3 * first.size[1] * (kind != "laptop")
        assert {tuple(paint) for paint in colour[differs]} == {tuple(paint) for paint in colours[0][differs]}
        assert len({tuple(paint) for paint in colour[differs]}) == 2
    stranger = small_thing(kind, len(LABELS))
    assert not np.array_equal(stranger.mesh.vertices, first.mesh.vertices)


def test_labels_differ_by_many_cells_and_hardly_in_gray():
    """Near, they are told apart by what is where; far off, where cells run into each other, hardly."""
    cells = [np.array([[cell == "#" for cell in row] for row in label]) for label in LABELS]
    for i, one in enumerate(cells):
        assert 0.5 < one.mean() < 0.7
        for other in cells[:i]:
            assert (one != other).sum() >= 6


@pytest.mark.parametrize("kind", Embedded.kinds)
def test_furniture_is_sound_and_of_its_kinds_size(kind):
    library = Embedded()
    for number in range(6):
        model = library.model(kind, number)
        check(model)
        width, _, height = model.size
        extent = height if SIZES[kind].extent == "height" else max(width, height)
        assert SIZES[kind].low - 1e-4 <= extent <= SIZES[kind].high + 1e-4
        assert same(model, library.model(kind, number))


@pytest.mark.parametrize("kind", household.KINDS)
def test_household_things_are_sound_and_each_another(kind):
    models = [household_thing(kind, number) for number in range(12)]
    for number, model in enumerate(models):
        check(model)
        assert 0.06 < max(model.size) < 0.95
        assert same(model, household_thing(kind, number))
    assert len({model.mesh.vertices.tobytes() for model in models}) == len(models)


@pytest.mark.parametrize("kind", FITTINGS)
def test_fittings_are_sound(kind):
    for number in range(6):
        model = Fitted().model(kind, number)
        check(model)
        assert 0.35 < min(model.size[:2]) < max(model.size) < 2.0
        assert same(model, Fitted().model(kind, number))


def test_a_fitted_library_has_the_embedded_furniture_as_it_is():
    assert set(FITTINGS).isdisjoint(Embedded.kinds)
    for kind in Embedded.kinds:
        assert same(Fitted().model(kind, 5), Embedded().model(kind, 5))


def test_unknown_kinds_are_refused():
    with pytest.raises(DataError, match=r"'sofas'.*did you mean sofa"):
        Embedded().model("sofas", 0)
    with pytest.raises(DataError, match=r"'cam'.*did you mean can"):
        small_thing("cam", 0)
    with pytest.raises(DataError, match=r"'toasters'.*did you mean toaster"):
        household_thing("toasters", 0)
