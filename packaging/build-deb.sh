#!/bin/sh
# A Debian package of the aircraft's side, for Debian 12 on this machine's architecture: pointclick-onboard_VERSION_ARCH.deb.
#
#   packaging/build-deb.sh OUT_DIR [WHEELS_DIR]
#
# Everything Python that it needs goes into /opt/pointclick, in the versions of requirements.lock; Debian gives python3
# alone. Wheels are fetched into WHEELS_DIR (OUT_DIR/wheels) once; with them there, nothing is fetched any more.
# $PYTHON must be of Debian's minor version (3.11): wheels are chosen and bytecode is made with it.
set -eu

checkout=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
out=$(cd "$1" && pwd)
wheels=${2:-$out/wheels}
python=${PYTHON:-python3}
minor=3.11

[ "$($python -c 'import sys; print("%d.%d" % sys.version_info[:2])')" = "$minor" ] \
	|| { echo "build-deb: $python is not Python $minor, which Debian 12 runs; name one: PYTHON=python$minor" >&2; exit 1; }
command -v dpkg-deb >/dev/null || { echo "build-deb: no dpkg-deb; sudo apt-get install dpkg" >&2; exit 1; }

version=$(sed -n 's/^version = "\(.*\)"/\1/p' "$checkout/pyproject.toml")
arch=$(dpkg --print-architecture)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
pip() { $python -m pip --disable-pip-version-check --quiet "$@"; }

# The package is built from a copy: a build leaves nothing in the checkout.
mkdir "$work/source"
for part in contract ground onboard pyproject.toml README.md; do
	cp -r "$checkout/$part" "$work/source/"
done

# What pyproject.toml declares for the aircraft, read as TOML, and the lock: fetched anew when either has changed.
$python - "$checkout/pyproject.toml" > "$work/declared" <<'PYTHON'
import sys, tomllib
project = tomllib.load(open(sys.argv[1], "rb"))["project"]
extras = project["optional-dependencies"]
print(*project["dependencies"], *extras["onboard"], *extras["terrain"], sep="\n")
PYTHON
cat "$work/declared" "$checkout/requirements.lock" > "$work/wanted"
if ! cmp -s "$work/wanted" "$wheels/.complete"; then
	echo "build-deb: fetching wheels into $wheels"
	mkdir -p "$wheels"
	pip download --dest "$wheels" --only-binary :all: --constraint "$checkout/requirements.lock" \
		setuptools --requirement "$work/declared"
	cp "$work/wanted" "$wheels/.complete"
fi

# An environment by hand: pip into a folder, and the one file that makes a folder an environment.
root=$work/root
home=$root/opt/pointclick
site=$home/lib/python$minor/site-packages
mkdir -p "$home/bin" "$site" "$root/usr/bin" "$root/DEBIAN"
printf 'home = /usr/bin\ninclude-system-site-packages = false\nversion = %s\n' "$minor" > "$home/pyvenv.cfg"
ln -s /usr/bin/python$minor "$home/bin/python3"
ln -s python3 "$home/bin/python"
pip wheel --no-deps --no-index --find-links "$wheels" --wheel-dir "$work" "$work/source"
# By what is declared, not by what lies there: an old wheel is left out, a missing one fails here.
pip install --no-index --find-links "$wheels" --constraint "$checkout/requirements.lock" --target "$site" --no-compile \
	--no-warn-conflicts "$(echo "$work"/pointclick-*.whl)[onboard,terrain]"
rm -rf "$site/bin"
# Nobody may write there later, so bytecode comes along; found by what the file is, not by when it was written.
$python -m compileall -q -j 1 --invalidation-mode unchecked-hash -s "$root" "$site" || true

for program in pc-onboard:onboard pc-ground:ground; do
	printf '#!/bin/sh\nexec /opt/pointclick/bin/python3 -I -m %s "$@"\n' "${program#*:}" > "$root/usr/bin/${program%%:*}"
	chmod 755 "$root/usr/bin/${program%%:*}"
done

doc=$root/usr/share/doc/pointclick-onboard
install -D -m 644 "$checkout/systemd/pointclick-onboard.service" "$root/lib/systemd/system/pointclick-onboard.service"
install -D -m 644 "$checkout/packaging/debian/sysusers" "$root/usr/lib/sysusers.d/pointclick.conf"
install -D -m 644 "$checkout/config.toml" "$root/etc/pointclick/config.toml"
install -d -m 755 "$root/etc/pointclick/config.d"
install -D -m 644 "$checkout/systemd/70-pointclick.rules" "$doc/examples/70-pointclick.rules"
for page in service faults; do
	[ ! -f "$checkout/docs/$page.md" ] || install -D -m 644 "$checkout/docs/$page.md" "$doc/$page.md"
done
echo /etc/pointclick/config.toml > "$root/DEBIAN/conffiles"
for script in postinst prerm postrm; do
	install -m 755 "$checkout/packaging/debian/$script" "$root/DEBIAN/$script"
done
cat > "$root/DEBIAN/control" <<CONTROL
Package: pointclick-onboard
Version: $version
Architecture: $arch
Maintainer: pointclick developers <pointclick@localhost>
Installed-Size: $(du -sk "$root" | cut -f1)
Depends: python3 (>= $minor), python3 (<< 3.12), systemd
Section: science
Priority: optional
Description: point-and-click target localisation, the aircraft's side
 Takes pictures and the autopilot's position and publishes what the ground needs
 to turn a click on a picture into a coordinate with its uncertainty.
CONTROL
dpkg-deb --root-owner-group -Zzstd -z3 --build "$root" "$out/pointclick-onboard_${version}_${arch}.deb" >/dev/null
echo "$out/pointclick-onboard_${version}_${arch}.deb"
