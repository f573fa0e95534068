"""What an installation brings, by a lock that is written down here."""

from __future__ import annotations

import pytest

from tools.release import extras

URL = "https://example.org/files"


def wheel(name: str, size: int) -> dict[str, object]:
    return {"url": f"{URL}/{name}", "size": size}


DOCUMENT = {
    "package": [
        {
            "name": "ours",
            "dependencies": [{"name": "numpy"}, {"name": "colorama", "marker": "sys_platform == 'win32'"}],
            "optional-dependencies": {"plot": [{"name": "matplotlib", "extra": ["fast"]}, {"name": "numpy"}]},
        },
        {
            "name": "numpy",
            "version": "2.1",
            "wheels": [
                wheel("numpy-2.1-cp313-cp313-manylinux_2_17_x86_64.manylinux2014_x86_64.whl", 3_000_000),
                wheel("numpy-2.1-cp313-cp313-manylinux_2_28_aarch64.whl", 2_000_000),
                wheel("numpy-2.1-cp312-cp312-manylinux_2_28_aarch64.whl", 9_000_000),
                wheel("numpy-2.1-cp313-cp313-musllinux_1_2_aarch64.whl", 9_000_000),
            ],
        },
        {"name": "colorama", "version": "1", "wheels": [wheel("colorama-1-py3-none-any.whl", 1)]},
        {
            "name": "matplotlib",
            "version": "3",
            "wheels": [
                wheel("matplotlib-3-py3-none-any.whl", 9_000_000),
                wheel("matplotlib-3-cp313-cp313-manylinux_2_28_x86_64.whl", 500_000),
            ],
            "dependencies": [{"name": "tzdata", "marker": "platform_machine == 'aarch64'"}],
            "optional-dependencies": {"fast": [{"name": "pillow"}]},
        },
        {"name": "tzdata", "version": "1", "wheels": [wheel("tzdata-1-py2.py3-none-any.whl", 250_000)]},
        {"name": "pillow", "version": "1", "wheels": [wheel("pillow-1-py3-none-any.whl", 1_000_000)]},
    ]
}
PACKAGES = extras.parse(DOCUMENT)


def test_what_an_extra_brings_is_what_the_machine_needs() -> None:
    def names(machine: str, *wanted: str) -> set[str]:
        return {package.name for package in extras.needed(PACKAGES, "ours", wanted, machine)}

    assert names("x86_64") == {"numpy"}
    assert names("x86_64", "plot") == {"numpy", "matplotlib", "pillow"}
    assert names("aarch64", "plot") == {"numpy", "matplotlib", "pillow", "tzdata"}


def test_sizes_are_of_the_wheels_that_pip_takes() -> None:
    both = [extras.size_mb(extras.needed(PACKAGES, "ours", ("plot",), m), m) for m in ("x86_64", "aarch64")]
    assert both == [4.5, 12.25]


def test_no_wheel_for_a_machine_is_said() -> None:
    odd = extras.parse(
        {"package": [{"name": "odd", "version": "1", "wheels": [wheel("odd-1-cp39-cp39-win32.whl", 1)]}]}
    )
    with pytest.raises(ValueError, match="odd 1: found no wheel for x86_64"):
        extras.size_mb(odd, "x86_64")


def test_licences_are_the_packages_own_words() -> None:
    assert extras.stated("numpy").startswith("BSD-3-Clause")
    assert extras.stated("nvidia-cublas-cu13") == extras.NVIDIA
