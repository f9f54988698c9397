"""Imports during which no garbage is looked for."""

from __future__ import annotations

import gc

import pytest

from warpdef.apps.imports import uncollected


def test_collection_goes_on_afterwards_as_it_was() -> None:
    assert gc.isenabled()
    try:
        with uncollected():
            assert not gc.isenabled()
            with uncollected():
                assert not gc.isenabled()
            assert not gc.isenabled()
        assert gc.isenabled() and gc.get_freeze_count() > 0
        with pytest.raises(ImportError), uncollected():
            raise ImportError
        assert gc.isenabled()
    finally:
        gc.unfreeze()
