"""Counts to kelvin and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.thermal_scale import ThermalScale

LEPTON = ThermalScale(0.01)


def test_a_radiometric_lepton_counts_hundredths_of_a_kelvin() -> None:
    counts = np.array([[27315, 30015], [0, 65535]], np.uint16)
    np.testing.assert_allclose(LEPTON.kelvin(counts), [[273.15, 300.15], [0.0, 655.35]], rtol=1e-6)
    assert LEPTON.kelvin(counts).dtype == np.float32


def test_what_is_beyond_the_counts_is_at_their_end() -> None:
    np.testing.assert_array_equal(LEPTON.counts([-5.0, 9000.0]), [0, 65535])


@given(scale=st.sampled_from([0.01, 0.1, 1 / 64, 0.04]), offset=st.floats(-300.0, 300.0), count=st.integers(0, 65535))
def test_counts_come_back_from_their_temperature(scale: float, offset: float, count: int) -> None:
    thermal = ThermalScale(scale, offset)
    assert thermal.counts(scale * count + offset) == count
    assert float(thermal.kelvin(np.uint16(count))) == pytest.approx(scale * count + offset, rel=1e-5, abs=1e-3)
