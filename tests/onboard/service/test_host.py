"""Temperature and disk of the computer, from files of the kernel's shape."""

from pathlib import Path

from onboard.service.host import cpu_temperature_c, free_mb


def test_the_hottest_sane_zone_counts(tmp_path: Path) -> None:
    for number, text in enumerate(["48000\n", "61250\n", "garbage", "900000", "-274000"]):
        (tmp_path / f"thermal_zone{number}").mkdir()
        (tmp_path / f"thermal_zone{number}" / "temp").write_text(text)
    assert cpu_temperature_c(tmp_path) == 61.25
    assert cpu_temperature_c(tmp_path / "nowhere") is None


def test_room_is_that_of_the_nearest_folder_there_is(tmp_path: Path) -> None:
    here, below = free_mb(tmp_path), free_mb(tmp_path / "not" / "yet")
    assert 0.0 < here < 1e9
    assert abs(here - below) < 100.0
