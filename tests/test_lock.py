"""The lock names each file that pip may install by its hash, and a release lists its parts."""

import hashlib
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.installed import needed
from tests.locked import PACKAGING, lines, program, versions

ROOT = PACKAGING.parent
lock = program("lock")


def test_every_package_has_the_hashes_of_its_files() -> None:
    packages = lock.read()
    assert len(packages) > 80
    for locked in packages.values():
        assert locked.sha256 and all(len(digest) == 64 and int(digest, 16) for digest in locked.sha256), locked.name
    assert set(needed(["numpy", "opencv-python-headless"])) <= set(packages)


@pytest.mark.parametrize(
    ("file", "is_for_us"),
    [
        ("numpy-2.4.6-cp311-cp311-manylinux_2_27_x86_64.manylinux_2_28_x86_64.whl", True),
        ("numpy-2.4.6-cp313-cp313-manylinux_2_27_aarch64.manylinux_2_28_aarch64.whl", True),
        ("numpy-2.4.6-cp313-cp313t-manylinux_2_28_x86_64.whl", False),
        ("numpy-2.4.6-cp310-cp310-manylinux_2_28_x86_64.whl", False),
        ("numpy-2.4.6-cp312-cp312-win_amd64.whl", False),
        ("numpy-2.4.6-cp312-cp312-macosx_11_0_x86_64.whl", False),
        ("numpy-2.4.6-cp312-cp312-musllinux_1_2_x86_64.whl", False),
        ("numpy-2.4.6-cp312-cp312-manylinux_2_28_ppc64le.whl", False),
        ("eclipse_zenoh-1.9-cp39-abi3-manylinux2014_aarch64.whl", True),
        ("x-1-cp314-abi3-manylinux2014_aarch64.whl", False),
        ("mcap-1.6.0-py3-none-any.whl", True), ("six-1-py2.py3-none-any.whl", True),
        ("x-1.tar.gz", False),
    ],
)  # fmt: skip
def test_only_files_for_our_pythons_and_processors_are_locked(file: str, is_for_us: bool) -> None:
    assert lock.fits(file) is is_for_us


def test_a_source_is_locked_only_where_a_machine_of_ours_has_no_wheel() -> None:
    def package(*wheels: str) -> dict[str, object]:
        files = [{"url": f"https://x/{file}", "hashes": {"sha256": file}} for file in wheels]
        return {"name": "It", "version": "1", "wheels": files, "sdist": {"url": "s", "hashes": {"sha256": "source"}}}

    every = [f"it-1-cp{p}-cp{p}-manylinux_2_28_{m}.whl" for p in lock.PYTHONS for m in lock.MACHINES]
    found = lock.lines_of({"packages": [package(*every), package(*every[1:]), package("it-1-py3-none-any.whl")]})
    assert ["source" in locked.sha256 for locked in found] == [False, True, False]


def test_the_lines_that_are_asked_for_come_with_their_hashes(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(
        json.dumps({"install": [{"metadata": {"name": n}} for n in ("NumPy", "pointclick")]})
    )
    (tmp_path / "wheels").mkdir()
    (tmp_path / "wheels" / "prometheus_client-0.1-py3-none-any.whl").touch()
    asked = ["of", f"@{tmp_path / 'report.json'}", tmp_path / "wheels", "typing_extensions"]
    printed = subprocess.run(
        [sys.executable, PACKAGING / "lock.py", *asked], capture_output=True, text=True, check=True, timeout=60
    ).stdout
    assert printed == lines(["numpy", "prometheus-client", "typing-extensions"])
    assert printed.count("--hash=sha256:") >= 8


@pytest.mark.long
def test_pip_refuses_a_file_that_is_not_the_locked_one(tmp_path: Path) -> None:
    """As `make` calls it."""
    wheel = tmp_path / "it-1-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("it-1.dist-info/METADATA", "Metadata-Version: 2.1\nName: it\nVersion: 1\n")
        archive.writestr("it-1.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr("it-1.dist-info/RECORD", "")
    codes = []
    for digest in (hashlib.sha256(wheel.read_bytes()).hexdigest(), "0" * 64):
        listed = tmp_path / "requirements.lock"
        listed.write_text(lock.Locked("it", "1", (digest,)).text + "\n")
        done = subprocess.run(
            [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--find-links", tmp_path, "--target",
             tmp_path / "there", "--require-hashes", "--requirement", listed],
            capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        codes.append(done.returncode)
    assert codes == [0, 1] and "HASHES" in done.stderr


def test_every_installation_is_one_by_hashes() -> None:
    """What is fetched for an installation is a locked file; a call without hashes only resolves."""
    installing = [
        line.strip()
        for name in ("Makefile", "packaging/build-deb.sh", "tests/bench/image/root.py", "tests/arm64/emulation.py")
        for line in (ROOT / name).read_text().splitlines()
        if "requirements.lock" in line and ("pip" in line or "--constraint" in line)
    ]
    assert not [line for line in installing if "--require-hashes" not in line and not line.startswith("#")]
    assert all("--require-hashes" in (ROOT / name).read_text() for name in ("Makefile", "packaging/build-deb.sh"))


def test_the_bill_of_materials_names_each_part_with_its_hashes(tmp_path: Path) -> None:
    out = tmp_path / "it.cdx.json"
    assert lock.main(["sbom", str(out), "numpy", "eclipse-zenoh"]) == 0
    bill = json.loads(out.read_text())
    assert (bill["bomFormat"], bill["specVersion"], bill["metadata"]["component"]["name"]) == (
        "CycloneDX",
        "1.6",
        "pointclick",
    )
    assert [part["purl"] for part in bill["components"]] == [
        f"pkg:pypi/{name}@{versions()[name]}" for name in ("eclipse-zenoh", "numpy")
    ]
    digests = [found["content"] for found in bill["components"][1]["externalReferences"][0]["hashes"]]
    assert digests == list(lock.read()["numpy"].sha256)
    assert len({part["bom-ref"] for part in bill["components"]}) == 2
