"""Which device is taken, and what is said where it is not there: no driver, an old one, a number too high."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import warp as wp

from warpdef import device as device_module
from warpdef.device import device_warnings, find_device
from warpdef.errors import DeviceError


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch):
    """A machine of so many devices, with such a driver, as Warp tells of it."""

    def make(devices: int = 0, driver: tuple[int, int] | None = None, there: bool = True, built=(13, 4)) -> None:
        aliases = ["cpu", *(f"cuda:{i}" for i in range(devices))]
        monkeypatch.setattr(device_module, "start_warp", lambda: None)
        monkeypatch.setattr(device_module, "_has_driver", lambda: there)
        monkeypatch.setattr(device_module, "_told", [])
        monkeypatch.setattr(wp, "get_devices", lambda: [SimpleNamespace(alias=a) for a in aliases])
        monkeypatch.setattr(wp, "get_device", lambda alias: alias)
        monkeypatch.setattr(wp, "get_cuda_driver_version", lambda: driver)
        monkeypatch.setattr(wp, "get_cuda_toolkit_version", lambda: built)
        monkeypatch.setattr(wp, "__version__", "1.19.0")
        monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)

    return make


def refused(name: str) -> str:
    with pytest.raises(DeviceError) as error:
        find_device(name)
    return str(error.value)


def test_here() -> None:
    assert find_device("cpu").is_cpu
    assert find_device("auto").is_cuda == wp.is_cuda_available()


def test_names(machine) -> None:
    machine(devices=2, driver=(13, 0))
    assert [find_device(n) for n in ("auto", "cpu", "cuda", "cuda:1")] == ["cuda:0", "cpu", "cuda:0", "cuda:1"]
    for name in ("gpu", "", "cuda:", "cuda:x", "cuda0"):
        assert f"expected one of auto, cpu, cuda:0, cuda:1, got {name or 'nothing'}" in refused(name)


def test_a_number_too_high(machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine(devices=1, driver=(13, 0))
    assert refused("cuda:1") == "--device: expected one of cuda:0, got cuda:1: 1 CUDA device here, counted from 0"
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3")
    assert refused("cuda:3").endswith("1 CUDA device here, counted from 0 (CUDA_VISIBLE_DEVICES is '3')")
    machine(devices=2, driver=(13, 0))
    assert "expected one of cuda:0, cuda:1, got cuda:7: 2 CUDA devices here" in refused("cuda:7")


@pytest.mark.parametrize("name", ["cuda", "cuda:0", "cuda:99"])
def test_no_driver(machine, name: str) -> None:
    machine(there=False)
    found = refused(name)
    assert f"a CUDA device for {name}, but NVIDIA's driver is not installed" in found
    assert "Warp 1.19.0 needs a driver for CUDA 13.0 or later (R580 or later)" in found
    assert "--device cpu" in found


def test_an_old_driver(machine) -> None:
    machine(driver=(12, 4))
    expected = "NVIDIA's driver is for CUDA 12.4, and Warp 1.19.0 needs a driver for CUDA 13.0 or later"
    assert expected in refused("cuda")
    machine(driver=(12, 4), built=(14, 1))  # of a release not known here nothing is said
    assert refused("cuda").endswith("a driver for CUDA 14.0 or later; mend that, or take --device cpu")


def test_a_driver_that_shows_nothing(machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine(driver=(13, 0))
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    assert "the driver (CUDA 13.0) shows no device (CUDA_VISIBLE_DEVICES is '')" in refused("cuda")
    machine(driver=None)
    assert "does not start" in refused("cuda")
    machine(driver=(13, 0), built=None)
    assert "built without CUDA" in refused("cuda")


def test_auto_says_why_it_takes_the_cpu_where_there_is_a_driver(machine, caplog: pytest.LogCaptureFixture) -> None:
    machine(there=False)
    assert find_device("auto") == "cpu" and device_warnings() == [] and not caplog.records
    machine(driver=(12, 4))
    assert [find_device("auto") for _ in range(2)] == ["cpu", "cpu"]
    (warning,) = device_warnings()
    assert "takes the CPU" in warning and "CUDA 12.4" in warning
    assert [warning in record.getMessage() for record in caplog.records] == [True]
