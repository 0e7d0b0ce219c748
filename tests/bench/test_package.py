"""The Debian package in a Debian of its own: installed, upgraded, removed, purged."""

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from tests.bench.image import cache
from tests.bench.image.root import CHECKOUT, PACKAGES, SUITE, _debian

Shell = Callable[[str], subprocess.CompletedProcess[str]]
INSTALL = "DEBIAN_FRONTEND=noninteractive dpkg -i /tmp/pointclick-onboard_*_amd64.deb"


@pytest.fixture(scope="module")
def debian(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    """A shell in a Debian 12 that no one has booted, with the package in /tmp."""
    out = cache.folder() / "deb"  # wheels stay there; the package is made again
    build = [CHECKOUT / "packaging" / "build-deb.sh", out]
    subprocess.run(
        build, check=True, timeout=600, env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "PYTHON": sys.executable}
    )
    root = tmp_path_factory.mktemp("debian")
    base = cache.artefact("debian", cache.key_of(SUITE, PACKAGES), _debian)
    subprocess.run(["tar", "-xf", base / "debian.tar", "-C", root], check=True)
    shutil.rmtree(root / "opt" / "pointclick", ignore_errors=True)
    for package in out.glob("pointclick-onboard_*_amd64.deb"):
        shutil.copy(package, root / "tmp")
    subprocess.run(["mount", "-t", "proc", "proc", root / "proc"], check=True)
    subprocess.run(["mount", "--bind", "/dev", root / "dev"], check=True)

    def shell(command: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["chroot", root, "/bin/sh", "-c", command], capture_output=True, text=True, check=False, timeout=300
        )

    try:
        yield shell
    finally:
        subprocess.run(["umount", root / "dev", root / "proc"], check=True)
        shutil.rmtree(root)


def test_the_package_installs_upgrades_and_leaves_nothing_when_purged(debian: Shell) -> None:
    done = debian(INSTALL)
    assert done.returncode == 0, done.stderr
    assert debian("systemctl is-enabled pointclick-onboard").stdout.strip() == "enabled"
    assert "pointclick" in debian("id pointclick").stdout
    assert debian("pc-onboard check-config").stdout == "/etc/pointclick/config.toml: good\n"
    flying = debian("pc-onboard check-config --fly")
    assert (flying.returncode, "camera.file is not set" in flying.stderr) == (2, True)
    assert debian("pc-onboard status").returncode == 3
    assert debian("pc-onboard run").returncode == 2
    assert debian("pc-ground --help").returncode == 0
    made = debian("pc-onboard make-credentials /tmp/keys --vehicle uav1 --address 10.0.0.7")
    assert made.returncode == 0, made.stderr

    debian("echo '# ours' >> /etc/pointclick/config.toml; systemctl disable pointclick-onboard")
    assert debian(INSTALL).returncode == 0
    assert debian("tail -1 /etc/pointclick/config.toml").stdout == "# ours\n"
    assert debian("systemctl is-enabled pointclick-onboard").stdout.strip() == "disabled"

    debian("mkdir -p /var/lib/pointclick /var/cache/pointclick && touch /var/lib/pointclick/alignment.json")
    assert debian("dpkg -r pointclick-onboard").returncode == 0
    kept = "test -f /etc/pointclick/config.toml && test -f /var/lib/pointclick/alignment.json && id pointclick"
    assert debian(kept).returncode == 0
    assert debian("test -e /opt/pointclick || test -e /usr/bin/pc-onboard").returncode == 1

    assert debian("dpkg -P pointclick-onboard").returncode == 0
    folders = "/etc/pointclick /var/lib/pointclick /var/cache/pointclick"
    left = f"ls -d {folders} /usr/lib/sysusers.d/pointclick.conf; id pointclick"
    assert debian(left).stdout == ""
