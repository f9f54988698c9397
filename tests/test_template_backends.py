"""Which library builds the template, and what is said when it is not there."""

from __future__ import annotations

import builtins
import sys
from types import SimpleNamespace

import pytest

from warpdef.errors import ConfigError, MissingPackageError
from warpdef.template import poisson


def without(monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    real = builtins.__import__

    def guarded(name, *args, **kwargs):
        if name.split(".")[0] in packages:
            raise ImportError(f"libGL.so.1: cannot open shared object file ({name})")
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", guarded)


def test_pymeshlab_that_does_not_import_names_the_system_packages(monkeypatch):
    without(monkeypatch, "pymeshlab")
    with pytest.raises(MissingPackageError, match="libgl1 libopengl0.*gpytoolbox, which needs no OpenGL"):
        poisson.load_backend("pymeshlab")


def test_pymeshlab_without_its_filters_names_the_system_packages(monkeypatch):
    some = SimpleNamespace(filter_list=lambda: ["meshing_isotropic_explicit_remeshing"])
    monkeypatch.setitem(sys.modules, "pymeshlab", some)
    with pytest.raises(
        MissingPackageError, match="without generate_surface_reconstruction_screened_poisson.*libopengl0"
    ):
        poisson.load_backend("pymeshlab")


def test_auto_falls_back_and_names_both_when_neither_is_there(monkeypatch):
    filters = SimpleNamespace(filter_list=lambda: list(poisson._PYMESHLAB_FILTERS))
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "pymeshlab", filters)
        without(patch, "gpytoolbox", "gpytoolbox_bindings")
        assert poisson.load_backend("auto").name == "pymeshlab"
        with pytest.raises(MissingPackageError, match="pip install gpytoolbox"):
            poisson.load_backend("gpytoolbox")
    without(monkeypatch, "gpytoolbox", "gpytoolbox_bindings", "pymeshlab")
    with pytest.raises(MissingPackageError, match="pip install gpytoolbox.*Nor can pymeshlab"):
        poisson.load_backend("auto")


def test_auto_prefers_gpytoolbox_and_other_names_are_refused():
    assert poisson.load_backend("auto").name == "gpytoolbox"
    with pytest.raises(ConfigError, match="template.backend: expected auto, gpytoolbox or pymeshlab, got 'open3d'"):
        poisson.load_backend("open3d")
