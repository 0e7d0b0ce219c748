#!/bin/sh
# Debian packages of the aircraft's side, for Debian 12 or 13: pointclick-onboard_VERSION_ARCH.deb, and beside it
# pointclick-onboard-terrain_VERSION_ARCH.deb, which adds what reads elevation models (rasterio). VERSION ends in +deb13
# for Debian 13: which of the two it is follows from $PYTHON, which is theirs (3.11 or 3.13).
#
#   ARCH=amd64|arm64 packaging/build-deb.sh OUT_DIR [WHEELS_DIR]
#
# Any of the two is built on any machine: wheels are fetched for the target, and nothing of it is run here. ARCH is by
# default this machine's. Everything Python that it needs goes into /opt/pointclick, in the versions of requirements.lock
# and without what an aircraft has no use for (slim.py); Debian gives python3 alone. Wheels are fetched into WHEELS_DIR
# (OUT_DIR/wheels/ARCH) once, by the lock's hashes; with them there, nothing is fetched any more. Beside the packages lies
# a list of their parts, pointclick-onboard_VERSION_ARCH.cdx.json (CycloneDX).
# $PYTHON must be of that Debian's minor version, of whatever architecture: bytecode is made with it, and slim.py runs in
# it with LIEF, which is fetched for this machine. A `strip` for the target is binutils-multiarch's.
set -eu

checkout=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
out=$(cd "$1" && pwd)
arch=${ARCH:-$(dpkg --print-architecture)}
wheels=${2:-$out/wheels/$arch}
python=${PYTHON:-python3}

# Of each Debian its Python, its glibc, and what its version is called by.
minor=$($python -c 'import sys; print("%d.%d" % sys.version_info[:2])')
case $minor in
	3.11) next=3.12 newest_glibc=36 suffix= ;;
	3.13) next=3.14 newest_glibc=41 suffix=+deb13 ;;
	*) echo "build-deb: $python is Python $minor; Debian 12 runs 3.11, Debian 13 runs 3.13; name one: PYTHON=python3.13" >&2; exit 1 ;;
esac
command -v dpkg-deb >/dev/null || { echo "build-deb: no dpkg-deb; sudo apt-get install dpkg" >&2; exit 1; }

version=$(sed -n 's/^version = "\(.*\)"/\1/p' "$checkout/pyproject.toml")$suffix
case $arch in
	amd64) machine=x86_64 ;;
	arm64) machine=aarch64 ;;
	*) echo "build-deb: ARCH is $arch; it is amd64 or arm64" >&2; exit 1 ;;
esac
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
pip() { $python -m pip --disable-pip-version-check --quiet "$@"; }
# Wheels for the target, whatever runs here.
target="--implementation cp --python-version $minor --abi cp${minor%.*}${minor#*.} --abi abi3 --abi none --only-binary :all:"
for glibc in $(seq $newest_glibc -1 5); do target="$target --platform manylinux_2_${glibc}_$machine"; done
target="$target --platform manylinux2014_$machine --platform linux_$machine"
[ $machine = aarch64 ] || target="$target --platform manylinux2010_$machine --platform manylinux1_$machine"

# The package is built from a copy: a build leaves nothing in the checkout.
mkdir "$work/source"
for part in contract ground onboard pyproject.toml README.md; do
	cp -r "$checkout/$part" "$work/source/"
done
# The build backend that pyproject.toml names; without frontend/ beside it, it builds no page.
install -D -m 644 "$checkout/packaging/with_page.py" "$work/source/packaging/with_page.py"

locked() { $python "$checkout/packaging/lock.py" "$@"; }
locked pins > "$work/pins"
# What pyproject.toml declares for the aircraft, read as TOML, and the lock: fetched anew when either has changed.
$python - "$checkout/pyproject.toml" > "$work/declared" <<'PYTHON'
import sys, tomllib
project = tomllib.load(open(sys.argv[1], "rb"))["project"]
extras = project["optional-dependencies"]
print(*project["dependencies"], *extras["onboard"], *extras["terrain"], sep="\n")
PYTHON
{ echo "# Python $minor"; cat "$work/declared" "$checkout/requirements.lock"; } > "$work/wanted"
if ! cmp -s "$work/wanted" "$wheels/.complete"; then
	echo "build-deb: fetching wheels into $wheels"
	mkdir -p "$wheels"
	# What they need is resolved first; then exactly those files are fetched whose hashes the lock has.
	pip install --dry-run --ignore-installed --report "$wheels/.report" --target "$work/nowhere" $target \
		--constraint "$work/pins" setuptools --requirement "$work/declared"
	locked of "@$wheels/.report" > "$work/hashed"
	pip download --dest "$wheels" $target --no-deps --require-hashes --requirement "$work/hashed"
	locked of lief > "$work/hashed"
	pip download --dest "$wheels/tools" --only-binary :all: --no-deps --require-hashes --requirement "$work/hashed"
	cp "$work/wanted" "$wheels/.complete"
fi

# An environment by hand: pip into a folder, and the one file that makes a folder an environment.
root=$work/root
home=$root/opt/pointclick
site=$home/lib/python$minor/site-packages
extra=$work/extra
extra_site=$extra/opt/pointclick/lib/python$minor/site-packages
mkdir -p "$home/bin" "$site" "$extra_site" "$root/usr/bin" "$root/DEBIAN" "$extra/DEBIAN"
printf 'home = /usr/bin\ninclude-system-site-packages = false\nversion = %s\n' "$minor" > "$home/pyvenv.cfg"
ln -s /usr/bin/python$minor "$home/bin/python3"
ln -s python3 "$home/bin/python"
pip wheel --no-deps --no-index --find-links "$wheels" --wheel-dir "$work" "$work/source"
pip install --no-index --find-links "$wheels/tools" --constraint "$work/pins" --target "$work/tools" lief
slim() { PYTHONPATH=$work/tools $python "$checkout/packaging/slim.py" "$@"; }
# By what is declared, not by what lies there: an old wheel is left out, a missing one fails here.
install_into() {
	pip install --no-index --find-links "$wheels" --constraint "$work/pins" $target --target "$1" \
		--no-compile --no-warn-conflicts "$(echo "$work"/pointclick-*.whl)[$2]"
}
install_into "$site" onboard
install_into "$extra_site" terrain
echo "build-deb: pointclick-onboard-terrain for $arch"
slim "$extra_site" "$arch" --without "$site"
echo "build-deb: pointclick-onboard for $arch"
slim "$site" "$arch"
# Nobody may write there later, so bytecode comes along; found by what the file is, not by when it was written. Of other
# people's packages it is all that comes, their sources would be the same once more; but cv2 reads its own.
for part in "$root" "$extra"; do
	folder=$part/opt/pointclick/lib/python$minor/site-packages
	for package in contract ground onboard cv2; do
		[ ! -d "$folder/$package" ] || mv "$folder/$package" "$work/"
	done
	$python -m compileall -q -b -j 0 --invalidation-mode unchecked-hash -s "$part" "$folder"
	find "$folder" -name '*.py' -delete
done
for package in contract ground onboard cv2; do
	mv "$work/$package" "$site/"
	$python -m compileall -q -j 0 --invalidation-mode unchecked-hash -s "$root" "$site/$package"
done

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
install -D -m 644 "$checkout/examples/own_camera.py" "$doc/examples/own_camera.py"
for page in "$checkout"/docs/*.md; do  # each links to others
	[ ! -f "$page" ] || install -D -m 644 "$page" "$doc/${page##*/}"
done
echo /etc/pointclick/config.toml > "$root/DEBIAN/conffiles"
for script in postinst prerm postrm; do
	install -m 755 "$checkout/packaging/debian/$script" "$root/DEBIAN/$script"
done
# For camera.device = "rtsp://...", "libcamera:" and "gst:...": the helper runs under Debian's own Python.
gstreamer="python3-gi, gir1.2-gstreamer-1.0 (>= 1.22), gir1.2-gst-plugins-base-1.0, gstreamer1.0-plugins-base,
 gstreamer1.0-plugins-good, gstreamer1.0-plugins-bad, gstreamer1.0-libav"
cat > "$root/DEBIAN/control" <<CONTROL
Package: pointclick-onboard
Version: $version
Architecture: $arch
Maintainer: pointclick developers <pointclick@localhost>
Installed-Size: $(du -sk --apparent-size "$root" | cut -f1)
Depends: python3 (>= $minor), python3 (<< $next), systemd
Recommends: $gstreamer
Suggests: gstreamer1.0-libcamera, libcamera-ipa, pointclick-onboard-terrain
Section: science
Priority: optional
Description: point-and-click target localisation, the aircraft's side
 Takes pictures and the autopilot's position and publishes what the ground needs
 to turn a click on a picture into a coordinate with its uncertainty.
CONTROL
cat > "$extra/DEBIAN/control" <<CONTROL
Package: pointclick-onboard-terrain
Version: $version
Architecture: $arch
Maintainer: pointclick developers <pointclick@localhost>
Installed-Size: $(du -sk --apparent-size "$extra" | cut -f1)
Depends: pointclick-onboard (= $version)
Section: science
Priority: optional
Description: point-and-click target localisation, elevation models
 Reads GeoTIFF and SRTM for pointclick-onboard: terrain.path in its configuration.
CONTROL
for part in "$extra:pointclick-onboard-terrain" "$root:pointclick-onboard"; do
	package=$out/${part##*:}_${version}_${arch}.deb
	dpkg-deb --root-owner-group -Zzstd -z9 --build "${part%:*}" "$package" >/dev/null
	echo "build-deb: $(($(stat -c %s "$package") / 1000000)) MB, $(($(du -sb "${part%:*}" | cut -f1) / 1000000)) MB installed:" \
		"$(basename "$package")"
done
# What is in it, for whoever looks for a package with a fault: CycloneDX.
locked sbom "${package%.deb}.cdx.json" "@$wheels/.report"
echo "$package"
