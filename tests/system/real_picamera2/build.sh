#!/usr/bin/env bash
# Builds what tests/system/real_picamera2/ runs on, under build/libcamera/: libcamera with its virtual pipeline
# alone, from Debian's source package, and the wheel of picamera2 in an environment of its own.
# Takes about 8 minutes on two cores, no time where it is there already, and goes on where it was
# interrupted. Exits with 77 where something cannot be had, and says what: the tests then count as not
# run.
#
#     tests/system/real_picamera2/build.sh [PYTHON]    PYTHON has this project installed; .venv/bin/python
set -euo pipefail
cd "$(dirname "$0")/../../.."

readonly SUITE=sid KNOWN=0.7.2
readonly PACKAGES=(dpkg-dev g++ pkg-config
  libcap-dev libgnutls28-dev libjpeg-dev libudev-dev libyaml-dev libyuv-dev)
readonly BUILD="$PWD/build/libcamera" HERE="$PWD/tests/system/real_picamera2"
# Or libcamera would call itself by the version of the repository around it.
export GIT_CEILING_DIRECTORIES="$BUILD"
PYTHON=$(realpath --no-symlinks "${1:-.venv/bin/python}")

not_run() {
  echo "not run: $*" >&2
  exit 77
}

packages_of() { "$1" -c 'import sysconfig; print(sysconfig.get_path("purelib"))'; }

[ -x "$PYTHON" ] || not_run "$PYTHON is missing: run make test first"
compile() {
  local suffix
  suffix=$("$BUILD/venv/bin/python" -c 'import sysconfig; print(sysconfig.get_config_var("EXT_SUFFIX"))')
  "$BUILD/venv/bin/ninja" -C "$BUILD/meson" "src/py/libcamera/_libcamera$suffix" >"$BUILD/compile.log" ||
    { tail -n 30 "$BUILD/compile.log" >&2; exit 1; }
  "$BUILD/venv/bin/python" -c 'import libcamera'
}

# What stands there was prepared from these very files, or is made anew.
made_from() { cat "$HERE/build.sh" "$HERE/requirements.txt" "$HERE/virtual.yaml" | sha256sum; }
if [ "$(cat "$BUILD/made-from" 2>/dev/null)" = "$(made_from)" ]; then
  compile
  exit 0
fi

command -v apt-get >/dev/null || not_run "libcamera's source comes from Debian: use Debian, or a container of it"
missing=()
for package in "${PACKAGES[@]}"; do
  dpkg-query --show --showformat '${db:Status-Status}' "$package" 2>/dev/null | grep -qx installed ||
    missing+=("$package")
done
if [ ${#missing[@]} -gt 0 ]; then
  [ "$(id -u)" = 0 ] || not_run "run apt-get install ${missing[*]}"
  { apt-get update --quiet && apt-get install --quiet --yes --no-install-recommends "${missing[@]}"; } ||
    not_run "apt-get cannot install ${missing[*]}"
fi

rm -rf "$BUILD"
mkdir -p "$BUILD"/apt/{parts,lists/partial,cache/archives/partial} "$BUILD/source"

echo "== source of libcamera from Debian $SUITE"
# Lists of its own: this machine's stay as they are. apt checks the signature.
cat >"$BUILD/apt/parts/$SUITE.sources" <<EOF
Types: deb-src
URIs: http://deb.debian.org/debian
Suites: $SUITE
Components: main
Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg
EOF
apt() {
  apt-get --quiet --option Dir::Etc::SourceList=/dev/null --option Dir::Etc::SourceParts="$BUILD/apt/parts" \
    --option Dir::State::Lists="$BUILD/apt/lists" --option Dir::Cache="$BUILD/apt/cache" \
    --option APT::Sandbox::User="$(id -un)" "$@"
}
apt update || not_run "Debian's package lists cannot be had"
(cd "$BUILD/source" && apt source --download-only libcamera) || not_run "libcamera's source cannot be had"
(cd "$BUILD/source" && dpkg-source --no-check --extract libcamera_*.dsc "$BUILD/libcamera")
grep -q "version : '$KNOWN'" "$BUILD/libcamera/meson.build" ||
  echo "libcamera is not the version $KNOWN these tests were written with" >&2

echo "== picamera2 and the tools of the build"
"$PYTHON" -m venv "$BUILD/venv"
PATH="$BUILD/venv/bin:$PATH"
# What this project was tested with comes from its own environment, and is not installed twice.
echo "import site; site.addsitedir('$(packages_of "$PYTHON")')" >"$(packages_of python)/project.pth"
python -m pip install --quiet --requirement "$HERE/requirements.txt" || not_run "pip cannot install picamera2"

echo "== libcamera"
# It is used where it was built, and takes its cameras from the source's folder.
cp "$HERE/virtual.yaml" "$BUILD/libcamera/src/libcamera/pipeline/virtual/data/"
meson setup "$BUILD/meson" "$BUILD/libcamera" --buildtype plain --optimization 1 \
  --auto-features disabled -Dwerror=false \
  -Dpipelines=virtual -Dipas= -Dpycamera=enabled -Dudev=enabled >"$BUILD/meson.log" ||
  { tail -n 30 "$BUILD/meson.log" >&2; exit 1; }
echo "$BUILD/meson/src/py" >"$(packages_of python)/libcamera.pth"
made_from >"$BUILD/made-from"
compile
