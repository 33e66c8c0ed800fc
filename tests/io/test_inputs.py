"""Inputs: how large they are in words, and how much memory there is for them."""

import pytest

from shapefit.errors import InputError
from shapefit.io import inputs


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (0, "0 bytes"),
        (1, "1 bytes"),
        (999, "999 bytes"),
        (1000, "1 kB"),
        (12_345, "12.3 kB"),
        (999_000, "999 kB"),
        (999_999, "1 MB"),
        (1_000_000, "1 MB"),
        (6_700_000_000, "6.7 GB"),
        (10**12, "1 TB"),
        (3 * 10**17, "300 PB"),
    ],
)
def test_a_size_has_three_digits_and_the_largest_unit_that_it_fills(size, words):
    assert inputs.format_bytes(size) == words


class TestFreeMemory:
    """It is the least of what the machine, the container and the process have."""

    @pytest.fixture
    def container(self, tmp_path, monkeypatch):
        """Return the function that states the memory of a container."""
        pytest.importorskip("resource", reason="this system does not say it")
        monkeypatch.setattr(inputs, "CGROUP", tmp_path)

        def state(limit, used):
            (tmp_path / "memory.max").write_text(f"{limit}\n")
            (tmp_path / "memory.current").write_text(f"{used}\n")

        return state

    def test_a_container_has_what_it_does_not_use(self, container):
        container(limit=5_000_000, used=2_000_000)
        assert inputs.free_memory() == 3_000_000

    def test_a_container_that_is_full_has_none(self, container):
        container(limit=5_000_000, used=6_000_000)
        assert inputs.free_memory() == 0

    def test_a_container_without_a_limit_has_what_the_machine_has(self, container):
        container(limit=10**18, used=0)
        of_machine = inputs.free_memory()
        container(limit="max", used=2_000_000)
        unlimited = inputs.free_memory()
        assert unlimited == pytest.approx(of_machine, rel=0.2)

    def test_a_process_beyond_its_own_limit_has_none(self, container, monkeypatch):
        container(limit="max", used=0)
        of_one_megabyte = (1_000_000, 1_000_000)
        monkeypatch.setattr("resource.getrlimit", lambda _: of_one_megabyte)
        assert inputs.free_memory() == 0


class TestUnpacked:
    """What is packed may become so many times as large, or 67 MB."""

    FEW = 10
    MANY = inputs.ALWAYS_FITS

    @pytest.mark.parametrize(
        ("packed", "most"),
        [(FEW, inputs.ALWAYS_FITS), (MANY, inputs.MAX_INFLATION * MANY)],
    )
    def test_one_byte_more_is_refused(self, packed, most):
        inputs.check_unpacked("t.csv.gz", most, packed)
        with pytest.raises(InputError, match=r"of it become .* or more; unpack it"):
            inputs.check_unpacked("t.csv.gz", most + 1, packed)
