# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Correcting groups of photographs: splitting, merging, names."""

from __future__ import annotations

import pytest

from fipt_blender.core.photographs.editing import free_name, merge_groups, split_group
from fipt_blender.core.photographs.preparation import Group
from fipt_blender.core.run.errors import FiptError

GROUPS = [Group("a", ("a.jpg", "x/b.jpg", "c.jpg")), Group("B", ("d.jpg",), False), Group("e", ("e.jpg",))]


def test_split_names_the_second_part_by_its_first_photograph():
    split = split_group(GROUPS, 0, 1)
    assert [group.name for group in split] == ["a", "b-2", "B", "e"]  # "B" is taken on some file systems
    assert split[0].photographs == ("a.jpg",) and split[1].photographs == ("x/b.jpg", "c.jpg")
    assert split[2:] == GROUPS[1:]


@pytest.mark.parametrize(("index", "at"), [(0, 0), (0, 3), (1, 0), (1, 1)])
def test_split_refuses_an_empty_part(index, at):
    with pytest.raises(FiptError) as caught:
        split_group(GROUPS, index, at)
    assert caught.value.code == "group-not-split"


def test_merge_keeps_the_first_name_and_undoes_a_split():
    merged = merge_groups(GROUPS, 1)
    assert merged == [GROUPS[0], Group("B", ("d.jpg", "e.jpg"), True)]
    assert merge_groups(split_group(GROUPS, 0, 2), 0) == GROUPS
    for index in (2, -1):
        with pytest.raises(FiptError) as caught:
            merge_groups(GROUPS, index)
        assert caught.value.code == "group-not-merged"


def test_free_names_differ_in_any_case():
    assert [free_name("A", taken) for taken in ((), ("b",), ("a",), ("a", "A-2"))] == ["A", "A", "A-2", "A-3"]
