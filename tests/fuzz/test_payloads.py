"""A part of what `make fuzz` runs a million of."""

from pathlib import Path

import pytest

from tests.fuzz.payloads import Fuzz
from tests.rest_long import rest_long


@pytest.mark.parametrize("seed", rest_long([1, 2]))
def test_damaged_inputs_are_read_or_refused_as_promised(seed: int, tmp_path: Path) -> None:
    result = Fuzz(seed, tmp_path).run(6000)
    assert result.count == 6000
    # The damage is neither so great that nothing is read nor so small that all is; a recording is read past most of it.
    for kind, most in (("set", 0.8), ("packet", 0.8), ("picture", 0.8), ("status", 0.8), ("recording", 0.9)):
        ends = {end: n for end, n in result.ends.items() if end.startswith(kind)}
        assert 0.01 < ends[f"{kind} read"] / sum(ends.values()) < most, ends
    assert result.ends["set CorruptPayload"] > 500 and result.ends["set NewerPayload"] > 5
    assert result.ends["set clicked"] > 5
