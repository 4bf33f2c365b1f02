"""The public Python API."""

from __future__ import annotations

import envcraft


def test_each_public_name_is_where_the_api_looks_for_it() -> None:
    assert {*envcraft._MODULES, "__version__"} == set(envcraft.__all__)
    for name, module in envcraft._MODULES.items():
        assert getattr(getattr(envcraft, name), "__name__", name) == name, module


def test_dir_lists_names_that_are_not_imported_yet() -> None:
    assert set(envcraft.__all__) <= set(dir(envcraft))
